// Lenses calibrated from boards: against the truth where it is known, against themselves where it
// is not, and against OpenCV's two fisheye calibrations on the same corners. Usage: bench_lens
// [truth] [edge] [peers] [real]; all of them if none is named.
#include <fmt/core.h>
#include <fmt/ranges.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <opencv2/calib3d.hpp>
#include <opencv2/ccalib/omnidir.hpp>
#include <set>
#include <thread>

#include "calibration/lens/board_detection.h"
#include "calibration/lens/lens_calibration.h"
#include "tests/calibration/lens/synthetic_lens.h"

namespace {

using namespace lightsketch;
using Clock = std::chrono::steady_clock;
using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;
namespace fs = std::filesystem;

const char* verdict(bool good) { return good ? "ok" : "MISSED"; }

TrueLens lensOf(TrueLens::Kind kind, int size) {
  TrueLens lens;
  lens.kind = kind;
  const double scale = size / 1920.0;
  lens.width = lens.height = size;
  lens.focal *= scale;
  lens.cx *= scale;
  lens.cy *= scale;
  return lens;
}

const char* nameOf(TrueLens::Kind kind) {
  switch (kind) {
    case TrueLens::Kind::kFamily:
      return "A, in the family";
    case TrueLens::Kind::kOutside:
      return "B, in no family";
    case TrueLens::Kind::kPupil:
      return "N, moving pupil";
    case TrueLens::Kind::kPinhole:
      return "perspective";
  }
  return "";
}

void benchTruth() {
  fmt::print(
      "Synthetic lenses, 40 views, 0.2 px noise, corners to 94 degrees, 6 seeds, family chosen by "
      "the program\nError at 92 degrees after the best rotation, and predicted against actual "
      "error (rms over seeds) per 15 degrees\n\n");
  struct Case {
    TrueLens::Kind kind;
    int size;
    double rmsBar;
    double largestBar;
  };
  using Kind = TrueLens::Kind;
  for (const Case& c : {Case{Kind::kFamily, 1920, 0.01, 0.02}, Case{Kind::kFamily, 960, 0.02, 0.04},
                        Case{Kind::kOutside, 1920, 0, 0.05}, Case{Kind::kOutside, 960, 0, 0.10},
                        Case{Kind::kPupil, 1920, 0, 0}}) {
    const TrueLens lens = lensOf(c.kind, c.size);
    double squares = 0;
    double worstRms = 0;
    double largest = 0;
    double slowest = 0;
    double total = 0;
    std::vector<double> actual(7);
    std::vector<double> predicted(7);
    std::vector<int> counts(7);
    std::string families;
    for (unsigned seed = 101; seed <= 106; ++seed) {
      SceneOptions scene;
      scene.seed = seed;
      const auto views = syntheticViews(lens, largeBoard(), scene);
      SilentProgress progress;
      const auto start = Clock::now();
      const auto result = calibrateLens(views, largeBoard(), lens.width, lens.height, {}, progress);
      total += std::chrono::duration<double>(Clock::now() - start).count();
      if (!result) {
        fmt::print("  FAILED: {}\n", result.error().message);
        continue;
      }
      const auto errors = directionErrors(lens, *result->model, 92);
      const double rms = errors.rms(92, 92) / kDegree;
      squares += rms * rms / 6;
      worstRms = std::max(worstRms, rms);
      largest = std::max(largest, errors.largest(92, 92) / kDegree);
      slowest = std::max(slowest, result->solveSeconds);
      const std::string family = describe(result->family);
      if (families.find(family) == std::string::npos) {
        families += (families.empty() ? "" : " / ") + family;
      }
      for (std::size_t i = 0; i < errors.errors.size(); ++i) {
        const Vector3d& direction = errors.directions[i];
        if (!result->model->covers(direction)) continue;
        const auto ring = static_cast<std::size_t>(angleOf(direction) / kDegree / 15);
        // The same weight for every solid angle.
        const double weight = std::sin(angleOf(direction));
        actual[ring] += weight * errors.errors[i] * errors.errors[i];
        predicted[ring] += weight * result->model->directionCovariance(direction).trace();
        ++counts[ring];
      }
    }
    fmt::print("{} at {} px: {}\n", nameOf(c.kind), c.size, families);
    fmt::print(
        "  rms {:.4f} (worst seed {:.4f}){}  largest {:.4f}", std::sqrt(squares), worstRms,
        c.rmsBar > 0 ? fmt::format(", bar {:.2f} {}", c.rmsBar, verdict(worstRms <= c.rmsBar)) : "",
        largest);
    if (c.largestBar > 0)
      fmt::print(", bar {:.2f} {}", c.largestBar, verdict(largest <= c.largestBar));
    fmt::print(
        " degrees\n  solve at most {:.2f} s, bar 3 {}; with trials and splits {:.1f} s each\n",
        slowest, verdict(slowest <= 3), total / 6);
    fmt::print("  actual / predicted:");
    bool honest = true;
    for (std::size_t ring = 0; ring < actual.size(); ++ring) {
      if (counts[ring] == 0) continue;
      const double ratio = std::sqrt(actual[ring] / predicted[ring]);
      honest &= ratio <= 2 && ratio >= 0.5;
      fmt::print("  {:.2f}", ratio);
    }
    fmt::print(", bar 0.5 to 2 {}\n\n", verdict(honest));
    fflush(stdout);
  }
}

void benchEdge() {
  fmt::print("Corners only to 75 degrees (lens A): what the calibration says of the edge\n\n");
  const TrueLens lens = lensOf(TrueLens::Kind::kFamily, 1920);
  SceneOptions scene;
  scene.seed = 101;
  scene.fieldDegrees = 75;
  SilentProgress progress;
  const auto result = calibrateLens(syntheticViews(lens, largeBoard(), scene), largeBoard(),
                                    lens.width, lens.height, {}, progress);
  if (!result) return fmt::print("  FAILED: {}\n", result.error().message);
  for (const auto& warning : result->warnings) fmt::print("  warning: {}\n", warning);
  for (const auto& advice : result->advice) fmt::print("  advice:  {}\n", advice);
  const auto& field = result->model->uncertainty().coveredField;
  const auto [least, most] = std::ranges::minmax(field);
  const auto errors = directionErrors(lens, *result->model, 92);
  fmt::print(
      "  mask: covered to {:.1f} to {:.1f} degrees by azimuth; model valid to {:.0f}\n"
      "  residual {:.3f} px; error at 70 degrees {:.4f}, at 92 degrees {:.4f} (masked)\n\n",
      least.degrees(), most.degrees(), result->model->maxFieldAngle().degrees(),
      result->residualPixels, errors.rms(70, 70) / kDegree, errors.rms(92, 92) / kDegree);
}

// --- OpenCV's lenses, as cameras of ours --------------------------------------------------------

// project() alone is theirs; the inverse is found on the sphere by Newton's method.
class PeerLens final : public CameraModel {
 public:
  enum class Kind { kFisheye, kOmnidir };
  // fx, fy, cx, cy, k1..k4 or fx, fy, cx, cy, skew, xi, k1, k2, p1, p2.
  PeerLens(Kind kind, std::vector<double> values, int width, int height)
      : kind_(kind), v_(std::move(values)), width_(width), height_(height) {}

  int width() const override { return width_; }
  int height() const override { return height_; }
  Angle maxFieldAngle() const override { return Angle::degrees(120); }
  std::string modelName() const override { return "peer"; }
  Json parameters() const override { return {}; }

  std::optional<Vector2d> project(const Vector3d& direction) const override {
    const Vector3d d = direction.normalized();
    if (kind_ == Kind::kFisheye) {
      const double rho = d.head<2>().norm();
      const double theta = std::atan2(rho, d.z());
      const double t = theta * theta;
      const double radius = theta * (1 + t * (v_[4] + t * (v_[5] + t * (v_[6] + t * v_[7]))));
      const Vector2d n = rho > 1e-12 ? Vector2d(radius / rho * d.head<2>()) : Vector2d(d.head<2>());
      return Vector2d(v_[0] * n.x() + v_[2], v_[1] * n.y() + v_[3]);
    }
    // Mei and Rives 2007.
    const double z = d.z() + v_[5];
    if (!(z > 1e-3)) return std::nullopt;
    const double x = d.x() / z;
    const double y = d.y() / z;
    const double r2 = x * x + y * y;
    const double radial = 1 + r2 * (v_[6] + r2 * v_[7]);
    const double xd = x * radial + 2 * v_[8] * x * y + v_[9] * (r2 + 2 * x * x);
    const double yd = y * radial + 2 * v_[9] * x * y + v_[8] * (r2 + 2 * y * y);
    return Vector2d(v_[0] * xd + v_[4] * yd + v_[2], v_[1] * yd + v_[3]);
  }

  std::optional<Vector3d> unproject(const Vector2d& pixel) const override {
    const Vector2d off = pixel - Vector2d(v_[2], v_[3]);
    for (const double start : {0.9, 0.5, 1.2, 0.2, 1.6}) {
      Vector3d d(off.x(), off.y(), 0);
      d = off.norm() > 0 ? Vector3d(d.normalized() * std::sin(start)) : Vector3d::Zero();
      d.z() = std::cos(start);
      d.normalize();
      for (int i = 0; i < 60; ++i) {
        const auto at = project(d);
        if (!at) break;
        const Vector2d error = pixel - *at;
        if (error.norm() < 1e-9) return d;
        const Vector3d u = d.unitOrthogonal();
        const Vector3d w = d.cross(u);
        Matrix2d jacobian;
        const auto alongU = project(d + 1e-6 * u);
        const auto alongW = project(d + 1e-6 * w);
        if (!alongU || !alongW) break;
        jacobian << (*alongU - *at) / 1e-6, (*alongW - *at) / 1e-6;
        Vector2d step = jacobian.fullPivLu().solve(error);
        if (!step.allFinite()) break;
        if (step.norm() > 0.2) step *= 0.2 / step.norm();
        d = (d + step.x() * u + step.y() * w).normalized();
      }
    }
    return std::nullopt;
  }

 private:
  Kind kind_;
  std::vector<double> v_;
  int width_;
  int height_;
};

struct Peer {
  std::shared_ptr<const CameraModel> model;
  double seconds = 0;
  std::string note;  // what it needed, or why it failed
};

// Runs `solve` in a child of its own, ended after `limit` seconds; its answer, empty if none came.
std::vector<double> inChild(const std::function<std::vector<double>()>& solve, double limit) {
  int ends[2];
  if (pipe(ends) != 0) return {};
  fflush(stdout);
  const pid_t child = fork();
  if (child == 0) {
    std::vector<double> values;
    try {
      values = solve();
    } catch (const cv::Exception&) {
      values.clear();
    }
    const auto bytes = values.size() * sizeof(double);
    const bool written = write(ends[1], values.data(), bytes) == static_cast<ssize_t>(bytes);
    _exit(written ? 0 : 1);
  }
  close(ends[1]);
  const auto start = Clock::now();
  int status = 0;
  while (waitpid(child, &status, WNOHANG) == 0) {
    if (std::chrono::duration<double>(Clock::now() - start).count() > limit) kill(child, SIGKILL);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  std::vector<double> values(32);
  const auto got = read(ends[0], values.data(), values.size() * sizeof(double));
  close(ends[0]);
  values.resize(got > 0 ? static_cast<std::size_t>(got) / sizeof(double) : 0);
  if (std::ranges::any_of(values, [](double v) { return !std::isfinite(v); })) values.clear();
  return values;
}

// Corners within `limit` of `ours`' field, every `step`th; views that keep 12 or more.
struct PeerInput {
  std::vector<std::vector<cv::Vec3f>> object;
  std::vector<std::vector<cv::Vec2f>> image;
};
PeerInput peerInput(std::span<const BoardView> views, const BoardGeometry& board,
                    const CameraModel& ours, double limitDegrees, std::size_t step) {
  PeerInput input;
  for (const auto& view : views) {
    std::vector<cv::Vec3f> object;
    std::vector<cv::Vec2f> image;
    for (std::size_t i = 0; i < view.corners.size(); i += step) {
      const auto& corner = view.corners[i];
      const auto direction = ours.unproject(corner.pixel);
      if (!direction || angleOf(*direction) > limitDegrees * kDegree) continue;
      const Vector3d p = board.corner(corner.column, corner.row);
      object.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()), 0.0F);
      image.emplace_back(static_cast<float>(corner.pixel.x()),
                         static_cast<float>(corner.pixel.y()));
    }
    if (object.size() < 12) continue;
    input.object.push_back(std::move(object));
    input.image.push_back(std::move(image));
  }
  return input;
}

// Given a good focal length and centre to begin with, and fewer and fewer corners near the edge
// until it does not throw.
Peer fisheyePeer(std::span<const BoardView> views, const BoardGeometry& board,
                 const FisheyeModel& ours) {
  Peer peer;
  for (const double limit : {180.0, 88.0, 85.0, 80.0, 75.0, 70.0, 60.0}) {
    const auto input = peerInput(views, board, ours, limit, 1);
    const auto start = Clock::now();
    const auto values = inChild(
        [&] {
          cv::Mat k = (cv::Mat_<double>(3, 3) << ours.values().fx, 0, ours.values().cx, 0,
                       ours.values().fy, ours.values().cy, 0, 0, 1);
          cv::Mat d = cv::Mat::zeros(4, 1, CV_64F);
          cv::fisheye::calibrate(input.object, input.image, {ours.width(), ours.height()}, k, d,
                                 cv::noArray(), cv::noArray(),
                                 cv::fisheye::CALIB_USE_INTRINSIC_GUESS |
                                     cv::fisheye::CALIB_RECOMPUTE_EXTRINSIC |
                                     cv::fisheye::CALIB_FIX_SKEW,
                                 {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 200, 1e-9});
          return std::vector<double>{k.at<double>(0, 0), k.at<double>(1, 1), k.at<double>(0, 2),
                                     k.at<double>(1, 2), d.at<double>(0),    d.at<double>(1),
                                     d.at<double>(2),    d.at<double>(3)};
        },
        60);
    peer.seconds = std::chrono::duration<double>(Clock::now() - start).count();
    if (values.size() != 8) continue;
    peer.model =
        std::make_shared<PeerLens>(PeerLens::Kind::kFisheye, values, ours.width(), ours.height());
    peer.note = limit < 180 ? fmt::format("corners within {:.0f} degrees only", limit) : "";
    return peer;
  }
  peer.note = "throws, even with corners within 60 degrees only";
  return peer;
}

Peer omnidirPeer(std::span<const BoardView> views, const BoardGeometry& board,
                 const FisheyeModel& ours) {
  constexpr double kLimitSeconds = 120;
  Peer peer;
  // At most 70 corners of each view, for its time.
  const std::size_t step = std::max(1, board.cornerCount() / 70);
  const auto input = peerInput(views, board, ours, 180, step);
  const auto start = Clock::now();
  const auto values = inChild(
      [&] {
        cv::Mat k;
        cv::Mat xi;
        cv::Mat d;
        cv::Mat used;
        std::vector<cv::Mat> turns;
        std::vector<cv::Mat> shifts;
        cv::omnidir::calibrate(input.object, input.image, {ours.width(), ours.height()}, k, xi, d,
                               turns, shifts, 0,
                               {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 200, 1e-8}, used);
        return std::vector<double>{k.at<double>(0, 0), k.at<double>(1, 1), k.at<double>(0, 2),
                                   k.at<double>(1, 2), k.at<double>(0, 1), xi.at<double>(0),
                                   d.at<double>(0),    d.at<double>(1),    d.at<double>(2),
                                   d.at<double>(3)};
      },
      kLimitSeconds);
  peer.seconds = std::chrono::duration<double>(Clock::now() - start).count();
  if (values.size() == 10) {
    peer.model =
        std::make_shared<PeerLens>(PeerLens::Kind::kOmnidir, values, ours.width(), ours.height());
    if (step > 1) peer.note = fmt::format("every {}. corner", step);
  } else {
    peer.note = peer.seconds > kLimitSeconds ? "ended after 120 s" : "throws";
  }
  return peer;
}

// Distances of the corners of views that no lens has seen, poses fitted with each lens.
struct HeldOut {
  double squares = 0;
  int corners = 0;
  int views = 0;
  double rms() const { return std::sqrt(squares / corners); }
  HeldOut& operator+=(const HeldOut& other) {
    squares += other.squares;
    corners += other.corners;
    views += other.views;
    return *this;
  }
};
HeldOut heldOut(const CameraModel& model, std::span<const BoardView> views,
                const BoardGeometry& board, const Vector2d& warp) {
  HeldOut result;
  for (const auto& view : views) {
    const auto pose = boardPose(model, view, board, warp);
    if (!pose) continue;
    ++result.views;
    for (const auto& corner : view.corners) {
      const auto pixel =
          model.projectPoint(pose->cameraFromBoard * board.corner(corner.column, corner.row, warp));
      // A corner that the lens cannot show at all counts as 100 px.
      result.squares += pixel ? std::min(1e4, (*pixel - corner.pixel).squaredNorm()) : 1e4;
      ++result.corners;
    }
  }
  return result;
}

// Three lenses from the same views, judged by the views left out: every fourth, in turn for the
// first `folds` of four.
void compare(const std::string& name, std::vector<BoardView> views, const BoardGeometry& board,
             int width, int height, const TrueLens* truth, int folds) {
  SilentProgress progress;
  LensCalibrationOptions options;
  options.splits = 0;
  // Single wrong corners are thrown out for all: a calibration of all views says which.
  if (const auto all = calibrateLens(views, board, width, height, options, progress)) {
    for (std::size_t v = 0; v < views.size(); ++v) {
      std::vector<BoardCorner> kept;
      for (std::size_t c = 0; c < views[v].corners.size(); ++c) {
        if (all->views[v].corners[c].rejected.empty()) kept.push_back(views[v].corners[c]);
      }
      views[v].corners = std::move(kept);
    }
    std::erase_if(views, [](const BoardView& view) { return view.corners.size() < 12; });
  }
  struct Row {
    std::string who;
    HeldOut outside;
    double inner = NAN;  // rms error of directions to 80 and to 92 degrees, last fold
    double outer = NAN;
    double seconds = 0;
    std::set<std::string> notes;
    bool failed = false;
  };
  std::array<Row, 3> rows;
  rows[0].who = "lightsketch";
  rows[1].who = "cv::fisheye::calibrate";
  rows[2].who = "cv::omnidir::calibrate";
  const auto add = [&](Row& row, std::span<const BoardView> unseen, const CameraModel* model,
                       const Vector2d& warp, double seconds, const std::string& note) {
    row.seconds += seconds / folds;
    if (!note.empty()) row.notes.insert(note);
    if (!model) {
      row.failed = true;
      return;
    }
    row.outside += heldOut(*model, unseen, board, warp);
    if (truth) {
      const Bearing bearing = [&](const Vector2d& pixel) { return model->unproject(pixel); };
      row.inner = directionErrors(*truth, bearing, 80).rms(0, 80) / kDegree;
      row.outer = directionErrors(*truth, bearing, 92).rms(0, 92) / kDegree;
    }
  };
  std::size_t heldOutViews = 0;
  for (int fold = 0; fold < folds; ++fold) {
    std::vector<BoardView> seen;
    std::vector<BoardView> unseen;
    for (std::size_t v = 0; v < views.size(); ++v) {
      (static_cast<int>(v % 4) == fold ? unseen : seen).push_back(views[v]);
    }
    heldOutViews += unseen.size();
    const auto start = Clock::now();
    const auto ours = calibrateLens(seen, board, width, height, options, progress);
    if (!ours) return fmt::print("  FAILED: {}\n", ours.error().message);
    add(rows[0], unseen, ours->model.get(), ours->warpMetres,
        std::chrono::duration<double>(Clock::now() - start).count(), describe(ours->family));
    const auto fisheye = fisheyePeer(seen, board, *ours->model);
    add(rows[1], unseen, fisheye.model.get(), Vector2d::Zero(), fisheye.seconds, fisheye.note);
    const auto omnidir = omnidirPeer(seen, board, *ours->model);
    add(rows[2], unseen, omnidir.model.get(), Vector2d::Zero(), omnidir.seconds, omnidir.note);
  }
  fmt::print("{}: {} views, held out {} in {} of 4 folds\n", name, views.size(), heldOutViews,
             folds);
  fmt::print("  {:<24}{:>12}{:>12}{:>12}{:>10}\n", "", "held-out px", "0-80 deg", "0-92 deg",
             "seconds");
  bool lowest = true;
  for (const Row& row : rows) {
    std::string note = fmt::format("{}", fmt::join(row.notes, "; "));
    if (row.outside.views < static_cast<int>(heldOutViews) && !row.failed) {
      note += fmt::format("; {} of {} views could be placed", row.outside.views, heldOutViews);
    }
    const auto angle = [&](double degrees) {
      return truth ? std::isnan(degrees) ? "none" : fmt::format("{:.4f}", degrees) : "-";
    };
    fmt::print("  {:<24}{:>12}{:>12}{:>12}{:>10.1f}   {}\n", row.who,
               row.failed ? "failed" : fmt::format("{:.4f}", row.outside.rms()), angle(row.inner),
               angle(row.outer), row.seconds, note);
    if (&row == &rows[0] || row.failed) continue;
    lowest &= rows[0].outside.rms() < row.outside.rms();
    if (truth) lowest &= !(row.inner < rows[0].inner) && !(row.outer < rows[0].outer);
  }
  fmt::print("  ours lowest: {}\n\n", verdict(lowest));
  fflush(stdout);
}

void benchPeers() {
  fmt::print(
      "Against OpenCV on the same corners: rms error on views that no lens has seen, and of "
      "directions after the best rotation\n(the board is bent by 1.2 mm, which OpenCV's lenses do "
      "not solve for)\n\n");
  using Kind = TrueLens::Kind;
  for (const Kind kind : {Kind::kFamily, Kind::kOutside, Kind::kPupil}) {
    const TrueLens lens = lensOf(kind, 1920);
    SceneOptions scene;
    scene.seed = 101;
    compare(nameOf(kind), syntheticViews(lens, largeBoard(), scene), largeBoard(), lens.width,
            lens.height, &lens, 1);
  }
}

void benchReal() {
  const fs::path data = fs::path(LIGHTSKETCH_SOURCE_DIR) / ".." / "shared" / "data" / "fisheye";
  if (!fs::exists(data)) return fmt::print("Real boards: {} is not here\n", data.string());
  struct Set {
    const char* name;
    double spacing;
    double bar;  // degrees
  };
  for (const Set& set : {Set{"fish_1", 0.0325, 0.2}, Set{"copark86", 0.03, 0.4}}) {
    BoardGeometry board;
    board.kind = BoardGeometry::Kind::kChessboard;
    board.columns = 6;
    board.rows = 8;
    board.spacingMetres = set.spacing;
    SilentProgress progress;
    const auto files = imagesInFolder(data / set.name);
    if (!files) return fmt::print("  FAILED: {}\n", files.error().message);
    const auto search = detectBoards(*files, board, {}, progress);
    if (!search) return fmt::print("  FAILED: {}\n", search.error().message);
    const auto views = search->views();
    const auto result = calibrateLens(views, board, search->width, search->height, {}, progress);
    fmt::print("{}: {} of {} boards found\n", set.name, views.size(), files->size());
    if (!result) {
      fmt::print("  FAILED: {}\n", result.error().message);
      continue;
    }
    int rejected = 0;
    for (const auto& view : result->views) {
      if (!view.rejected.empty()) fmt::print("  {}: {}\n", view.name, view.rejected);
      for (const auto& corner : view.corners) {
        if (corner.rejected.empty() || !view.rejected.empty()) continue;
        ++rejected;
        fmt::print("  {}: corner {}, {}: {}\n", view.name, corner.column, corner.row,
                   corner.rejected);
      }
    }
    const auto& split = result->splitHalf;
    const double ratio = split.rms.radians() / split.predicted.radians();
    fmt::print("  {}; residual {:.3f} px, {} corners used, {} thrown out; solve {:.2f} s\n",
               describe(result->family), result->residualPixels, result->cornersUsed, rejected,
               result->solveSeconds);
    fmt::print("  split-half over {} splits: rms {:.4f} degrees, bar {:.1f} {}; largest {:.4f}\n",
               split.splits, split.rms.degrees(), set.bar, verdict(split.rms.degrees() <= set.bar),
               split.largest.degrees());
    fmt::print("  predicted {:.4f}: ratio {:.2f}, bar 0.5 to 2 {}; model error {:.4f} degrees\n",
               split.predicted.degrees(), ratio, verdict(ratio <= 2 && ratio >= 0.5),
               result->model->uncertainty().modelError.degrees());
    for (const auto& trial : result->trials) {
      fmt::print("  {} {:<46} held-out {:.4f} px, split-half {:.4f} degrees\n",
                 trial.chosen ? "*" : " ", describe(trial.family), trial.heldOutPixels,
                 trial.splitHalf.degrees());
    }
    for (const auto& warning : result->warnings) fmt::print("  warning: {}\n", warning);
    for (const auto& advice : result->advice) fmt::print("  advice:  {}\n", advice);
    compare(set.name, views, board, search->width, search->height, nullptr, 4);
  }
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> asked(argv + 1, argv + argc);
  const auto wants = [&](const char* what) {
    return asked.empty() || std::ranges::find(asked, what) != asked.end();
  };
  if (wants("truth")) benchTruth();
  if (wants("edge")) benchEdge();
  if (wants("peers")) benchPeers();
  if (wants("real")) benchReal();
}
