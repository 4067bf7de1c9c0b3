// Prints what libsdformat makes of a file: poses of links and joints in the world, axes, inertials.
#include <sdf/sdf.hh>
#include <cstdio>
#include <functional>
#include <string>
using V = ignition::math::Vector3d; using P = ignition::math::Pose3d;
static void pose(const P &p) { for (double x : {p.Pos().X(), p.Pos().Y(), p.Pos().Z(), p.Rot().W(), p.Rot().X(), p.Rot().Y(), p.Rot().Z()}) std::printf(" %.17g", x); }
int main(int, char **argv) {
  sdf::Root root; auto errors = root.Load(argv[1]);
  for (auto &e : errors) { std::fprintf(stderr, "%s\n", e.Message().c_str()); }
  if (!errors.empty()) return 1;
  std::function<void(const sdf::Model &, const std::string &, P)> show = [&](const sdf::Model &m, const std::string &prefix, P base) {
    P x; auto err = m.SemanticPose().Resolve(x); if (!err.empty()) { std::fprintf(stderr, "model\n"); }
    P here = base * x;
    for (uint64_t i = 0; i < m.LinkCount(); ++i) { auto l = m.LinkByIndex(i); P p; l->SemanticPose().Resolve(p, "__model__");
      std::printf("link %s%s", prefix.c_str(), l->Name().c_str()); pose(here * p); auto I = l->Inertial(); std::printf(" %.17g", I.MassMatrix().Mass()); pose(I.Pose());
      auto M = I.MassMatrix(); for (double v : {M.Ixx(), M.Iyy(), M.Izz(), M.Ixy(), M.Ixz(), M.Iyz()}) std::printf(" %.17g", v); std::printf("\n"); }
    for (uint64_t i = 0; i < m.JointCount(); ++i) { auto j = m.JointByIndex(i); P p; j->SemanticPose().Resolve(p, "__model__");
      std::string a, b; j->ResolveParentLink(a); j->ResolveChildLink(b);
      std::printf("joint %s%s %d %s %s", prefix.c_str(), j->Name().c_str(), (int)j->Type(), a.c_str(), b.c_str()); pose(here * p);
      for (int k = 0; k < 2; ++k) if (auto ax = j->Axis(k)) { V v; auto e = ax->ResolveXyz(v, "__model__"); v = (here.Rot()) * v; std::printf(" %.17g %.17g %.17g", v.X(), v.Y(), v.Z()); }
      std::printf("\n"); }
    for (uint64_t i = 0; i < m.ModelCount(); ++i) show(*m.ModelByIndex(i), prefix + m.ModelByIndex(i)->Name() + "::", here);
  };
  if (root.Model()) show(*root.Model(), "", P());
  for (uint64_t w = 0; w < root.WorldCount(); ++w) { auto W = root.WorldByIndex(w); auto g = W->Gravity(); std::printf("gravity %.17g %.17g %.17g\n", g.X(), g.Y(), g.Z());
    for (uint64_t i = 0; i < W->ModelCount(); ++i) show(*W->ModelByIndex(i), "", P()); }
}
