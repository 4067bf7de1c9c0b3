// Drives a crane in Gazebo Classic by a controller that is affine in the state, from tables, and logs what happens. No ROS.
//
//   effort = feed_forward[k] - gain[k] (z - setpoint[k]) + integral_gain * integral of (target - position),   z = (positions, rates)
//
// Row k of a table is for control instant k; beyond the end of a table its last row holds. Efforts are cut to the limits of the drives
// and held for a control period. Joints spawn at 0, which may lie outside of their ranges: they are put where they start in Load.

#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include <gazebo/common/common.hh>
#include <gazebo/physics/physics.hh>

namespace {

using Row = std::vector<double>;

std::vector<Row> table(const std::string &path) {
  std::ifstream file(path);
  std::vector<Row> rows;
  std::string line, cell;
  while (std::getline(file, line)) {
    std::istringstream cells(line);
    Row row;
    while (std::getline(cells, cell, ',')) row.push_back(std::stod(cell));
    rows.push_back(row);
  }
  if (rows.empty()) gzthrow("cannot read " + path);
  return rows;
}

const Row &at(const std::vector<Row> &rows, long k) { return rows[std::min<long>(k, rows.size() - 1)]; }

}  // namespace

class Drives : public gazebo::ModelPlugin {
 public:
  void Load(gazebo::physics::ModelPtr model, sdf::ElementPtr sdf) override {
    world_ = model->GetWorld();
    steps_ = sdf->Get<int>("steps_per_control");
    rows_ = sdf->Get<int>("rows");
    every_ = sdf->Get<int>("rows_between_logs");
    overwritten_ = sdf->Get<bool>("overwrite_passive_velocities");
    period_ = sdf->Get<double>("control_period");
    std::string header = "t_s", rates, efforts;
    for (auto one = sdf->GetElement("joint"); one; one = one->GetNextElement("joint")) {
      auto joint = model->GetJoint(one->Get<std::string>("name"));
      if (!joint) gzthrow("the model has no joint " + one->Get<std::string>("name"));
      joints_.push_back(joint);
      header += "," + one->Get<std::string>("column");
      rates += "," + one->Get<std::string>("rate_column");
      starts_.push_back(one->Get<double>("start"));
      speeds_.push_back(one->Get<double>("start_rate"));
      if (one->HasElement("effort_limit")) {
        drives_.push_back(joints_.size() - 1);
        limits_.push_back(one->Get<double>("effort_limit"));
        efforts += "," + one->Get<std::string>("effort_column");
      }
    }
    feed_forward_ = table("feed_forward.csv");
    gain_ = table("gain.csv");
    setpoint_ = table("setpoint.csv");
    target_ = table("target.csv");
    integrals_ = table("integral.csv");  // gain, limit and value at the start, a row each
    Place();
    log_ = std::fopen("log.csv.part", "w");
    if (!log_) gzthrow("cannot write log.csv.part");
    std::fprintf(log_, "%s%s%s\n", header.c_str(), rates.c_str(), efforts.c_str());
    connection_ = gazebo::event::Events::ConnectWorldUpdateBegin([this](const auto &) { Update(); });
  }

 private:
  void Place() {
    for (std::size_t i = 0; i < joints_.size(); ++i) joints_[i]->SetPosition(0, starts_[i]);
    for (std::size_t i = 0; i < joints_.size(); ++i)
      if (speeds_[i] != 0.0) joints_[i]->SetVelocity(0, speeds_[i]);
  }

  void Update() {
    // Gazebo's own clock reads one step at the first update: instants are counted here.
    if (step_ % steps_ == 0) Control(step_ / steps_);
    if (overwritten_) Overwrite();
    for (std::size_t i = 0; i < drives_.size(); ++i) joints_[drives_[i]]->SetForce(0, efforts_[i]);
    ++step_;
  }

  // What the article's version of gazebo_ros2_control did to every joint without a command.
  void Overwrite() {
    for (std::size_t i = 0, drive = 0; i < joints_.size(); ++i) {
      if (drive < drives_.size() && drives_[drive] == i) ++drive;
      else joints_[i]->SetVelocity(0, 0.0);
    }
  }

  void Control(long k) {
    if (k >= rows_) return;
    const std::size_t n = joints_.size(), m = drives_.size();
    Row z(2 * n);
    for (std::size_t i = 0; i < n; ++i) {
      z[i] = joints_[i]->Position(0);
      z[n + i] = joints_[i]->GetVelocity(0);
    }
    const Row &forward = at(feed_forward_, k), &gain = at(gain_, k), &setpoint = at(setpoint_, k), &target = at(target_, k);
    efforts_.assign(m, 0.0);
    for (std::size_t i = 0; i < m; ++i) {
      double effort = forward[i];
      for (std::size_t j = 0; j < 2 * n; ++j) effort -= gain[i * 2 * n + j] * (z[j] - setpoint[j]);
      const double error = target[i] - z[drives_[i]], integral = integrals_[2][i] + error * period_;
      const double total = effort + integrals_[0][i] * integral;
      if (std::abs(total) <= integrals_[1][i] || error * total < 0.0) integrals_[2][i] = integral;
      effort += integrals_[0][i] * integrals_[2][i];
      efforts_[i] = std::max(-limits_[i], std::min(limits_[i], effort));
    }
    if (k % every_ == 0) {
      std::fprintf(log_, "%.12g", k * period_);
      for (double value : z) std::fprintf(log_, ",%.17g", value);
      for (double value : efforts_) std::fprintf(log_, ",%.17g", value);
      std::fprintf(log_, "\n");
    }
    if (k == rows_ - 1) {
      const bool whole = std::fclose(log_) == 0;
      if (whole) std::rename("log.csv.part", "log.csv");
      kill(getpid(), SIGINT);  // the run is over, and so is the server
    }
  }

  gazebo::physics::WorldPtr world_;
  gazebo::event::ConnectionPtr connection_;
  std::vector<gazebo::physics::JointPtr> joints_;
  std::vector<std::size_t> drives_;
  std::vector<Row> feed_forward_, gain_, setpoint_, target_, integrals_;
  Row starts_, speeds_, limits_, efforts_;
  std::FILE *log_ = nullptr;
  double period_ = 0.0;
  long step_ = 0, steps_ = 1, rows_ = 0, every_ = 1;
  bool overwritten_ = false;
};

GZ_REGISTER_MODEL_PLUGIN(Drives)
