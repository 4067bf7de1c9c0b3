// Print what libsdformat makes of files: poses of links and joints in the world, inertials, axes,
// springs and damping. Each file begins with a line "file". The others are "link NAME pose mass pose inertia", "joint NAME TYPE PARENT CHILD
// pose axes" or "spring NAME stiffness reference damping"; a pose is x y z, then the quaternion
// w x y z; an inertia is xx yy zz xy xz yz.
#include <sdf/sdf.hh>

#include <cstdio>
#include <string>

using Pose = ignition::math::Pose3d;
using Vector = ignition::math::Vector3d;

static void print(const Pose &pose) {
  const auto &p = pose.Pos();
  const auto &r = pose.Rot();
  for (double number : {p.X(), p.Y(), p.Z(), r.W(), r.X(), r.Y(), r.Z()}) std::printf(" %.17g", number);
}

static void print_link(const sdf::Link &link, const std::string &prefix, const Pose &model) {
  Pose pose;
  link.SemanticPose().Resolve(pose, "__model__");
  std::printf("link %s%s", prefix.c_str(), link.Name().c_str());
  print(model * pose);
  const auto inertial = link.Inertial();
  const auto matrix = inertial.MassMatrix();
  std::printf(" %.17g", matrix.Mass());
  print(inertial.Pose());
  for (double moment : {matrix.Ixx(), matrix.Iyy(), matrix.Izz(), matrix.Ixy(), matrix.Ixz(), matrix.Iyz()})
    std::printf(" %.17g", moment);
  std::printf("\n");
}

static void print_joint(const sdf::Joint &joint, const std::string &prefix, const Pose &model) {
  Pose pose;
  joint.SemanticPose().Resolve(pose, "__model__");
  std::string parent, child;
  joint.ResolveParentLink(parent);
  joint.ResolveChildLink(child);
  const std::string name = prefix + joint.Name();
  std::printf("joint %s %d %s %s", name.c_str(), static_cast<int>(joint.Type()), parent.c_str(), child.c_str());
  print(model * pose);
  for (unsigned int i = 0; i < 2; ++i) {
    if (const auto *axis = joint.Axis(i)) {
      Vector direction;
      axis->ResolveXyz(direction, "__model__");
      direction = model.Rot() * direction;
      std::printf(" %.17g %.17g %.17g", direction.X(), direction.Y(), direction.Z());
    }
  }
  std::printf("\n");
  if (const auto *axis = joint.Axis(0))
    std::printf("spring %s %.17g %.17g %.17g\n", name.c_str(), axis->SpringStiffness(), axis->SpringReference(), axis->Damping());
}

static void print_model(const sdf::Model &model, const std::string &prefix, const Pose &base) {
  Pose pose;
  model.SemanticPose().Resolve(pose);
  pose = base * pose;
  for (uint64_t i = 0; i < model.LinkCount(); ++i) print_link(*model.LinkByIndex(i), prefix, pose);
  for (uint64_t i = 0; i < model.JointCount(); ++i) print_joint(*model.JointByIndex(i), prefix, pose);
  for (uint64_t i = 0; i < model.ModelCount(); ++i) {
    const auto &inner = *model.ModelByIndex(i);
    print_model(inner, prefix + inner.Name() + "::", pose);
  }
}

static bool print_file(const char *path) {
  std::printf("file\n");
  sdf::Root root;
  const auto errors = root.Load(path);
  for (const auto &error : errors) std::fprintf(stderr, "%s: %s\n", path, error.Message().c_str());
  if (!errors.empty()) return false;
  if (root.Model()) print_model(*root.Model(), "", Pose());
  for (uint64_t i = 0; i < root.WorldCount(); ++i) {
    const auto &world = *root.WorldByIndex(i);
    for (uint64_t j = 0; j < world.ModelCount(); ++j) print_model(*world.ModelByIndex(j), "", Pose());
  }
  return true;
}

int main(int count, char **arguments) {
  bool good = true;
  for (int i = 1; i < count; ++i) good = print_file(arguments[i]) && good;
  return good ? 0 : 1;
}
