// What the programs put before the cameras is where the truth says, by optics written out again.
#include "capture/rig/rig_program.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/imgproc.hpp>

#include "capture/rig/scene_view.h"
#include "capture/rig/source_view.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

class HeldLamp final : public LampMotion {
 public:
  void advanceTo(double) override {}
  LampState at(double) const override { return state; }
  LampState state{true, 0, Vector3d(0, 0, 0.9)};
};

// The views without their devices; a program for each.
struct Bench {
  HeldLamp lamp;
  Room room;
  std::shared_ptr<const StillLife> stillLife = *StillLife::load({});
  Play play;
  SceneView scene;
  SourceView first, second;

  static Play playOf(const StillLife& stillLife) {
    const ChromeBall ball{{0, 0, stillLife.tableHeight() + 0.025}, 0.025};
    const BoardAudience audience{
        stillLife.sceneFromCamera(),
        {0.2126, 0.1594},
        {firstSourceSeat().sceneFromCamera, secondSourceSeat().sceneFromCamera},
        stillLife.tableHeight()};
    return Play{ProgramLog(RigProgram::kDark), *HeldBoard::create({}, audience), ball,
                *stillLife.arranged({false, std::nullopt, std::nullopt}),
                *stillLife.arranged({false, ball, std::nullopt})};
  }
  // ProgramLog cannot be moved, so the play is built in place.
  Bench()
      : play(playOf(*stillLife)),
        scene(stillLife, room, lamp, 1, &play),
        first(stillLife, room, lamp, 2, {}, &play),
        second(stillLife, room, lamp, 3, {}, &play, secondSourceSeat()) {}

  // Programs follow each other at whole hours, so that times within one are easily named.
  double begin(RigProgram program) {
    hour += 1;
    play.programs.start(RigProgram::kDark, 3600 * hour - 1);
    play.programs.start(program, 3600 * hour);
    return 3600 * hour;
  }
  double hour = 0;

  static std::vector<std::uint8_t> expose(FrameSource& view, PixelFormat format, double time,
                                          double seconds) {
    ExposureRequest request;
    request.index = static_cast<std::uint64_t>(1000 * time);
    request.timeSeconds = time;
    request.format = format;
    request.region = {0, 0, view.sensorWidth(), view.sensorHeight()};
    request.exposureSeconds = seconds;
    std::vector<std::uint8_t> bytes;
    view.expose(request, bytes);
    return bytes;
  }
  // As grey values, like a detector wants them.
  cv::Mat picture(FrameSource& view, double time) {
    const bool colour = &view == &scene;
    auto bytes = expose(view, colour ? PixelFormat::kRgb8 : PixelFormat::kMono8, time,
                        colour ? 0.02 : 0.001);
    const cv::Mat all(view.sensorHeight(), view.sensorWidth(), colour ? CV_8UC3 : CV_8UC1,
                      bytes.data());
    cv::Mat grey;
    if (colour)
      cv::cvtColor(all, grey, cv::COLOR_RGB2GRAY);
    else
      grey = all.clone();
    return grey;
  }
  // The pinhole formula, written out again.
  Vector2d scenePixel(const Vector3d& point) const {
    const Vector3d p = stillLife->sceneFromCamera().inverse() * point;
    const double focal = 320 / std::tan(12 * std::numbers::pi / 180);
    return {focal * p.x() / p.z() + 320, focal * p.y() / p.z() + 240};
  }
};

Bench& bench() {
  static Bench instance;
  return instance;
}

// The board's stops as times in the middle of each, when nothing moves.
std::vector<double> stopsOf(const HeldBoard& board) {
  std::vector<double> stops;
  constexpr double kStep = 0.01;
  double since = 0;
  for (double t = 0; t < board.periodSeconds(); t += kStep) {
    if (board.stillAt(t)) continue;
    if (t - since > 0.3) stops.push_back(0.5 * (since + t));
    since = t;
  }
  return stops;
}

struct SeenCorner {
  Vector2d found, truth;
};

// Corners that cornerSubPix finds from where the truth says; those that a neighbour, the edge of
// the picture or a flat angle spoils are left out.
std::vector<SeenCorner> refined(
    const cv::Mat& grey, const HeldBoard& board, const Eigen::Isometry3d& sceneFromBoard,
    const Vector3d& eye, const std::function<std::optional<Vector2d>(const Vector3d&)>& project) {
  std::vector<SeenCorner> seen;
  for (int row = 0; row < board.options().rows; ++row) {
    for (int column = 0; column < board.options().columns; ++column) {
      const Vector3d corner = sceneFromBoard * board.corner(column, row);
      // Within half a square around, where is the picture squeezed most?
      double spacing = 1e9;
      const auto pixel = project(corner);
      bool whole = pixel.has_value();
      for (const auto& [dx, dy] : {std::pair(1, 0), {-1, 0}, {0, 1}, {0, -1}}) {
        const Vector3d near = sceneFromBoard * board.corner(column + dx, row + dy);
        const auto at = project(near);
        whole = whole && at;
        if (whole) spacing = std::min(spacing, (*at - *pixel).norm());
      }
      const Vector3d front = -sceneFromBoard.linear().col(2);
      if (!whole || front.dot((eye - corner).normalized()) < 0.45 || spacing < 16) continue;
      if (pixel->x() < 12 || pixel->y() < 12 || pixel->x() > grey.cols - 12 ||
          pixel->y() > grey.rows - 12) {
        continue;
      }
      std::vector<cv::Point2f> point{
          {static_cast<float>(pixel->x() - 0.5), static_cast<float>(pixel->y() - 0.5)}};
      const int half = std::clamp(static_cast<int>(0.12 * spacing), 2, 5);
      cv::cornerSubPix(grey, point, {half, half}, {-1, -1},
                       {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 60, 1e-4});
      seen.push_back({Vector2d(point[0].x + 0.5, point[0].y + 0.5), *pixel});
    }
  }
  return seen;
}

void expectAgreement(const std::vector<SeenCorner>& corners, std::size_t least, const char* who) {
  ASSERT_GT(corners.size(), least) << who;
  std::vector<double> errors;
  Vector2d mean = Vector2d::Zero();
  for (const SeenCorner& c : corners) {
    errors.push_back((c.found - c.truth).norm());
    mean += (c.found - c.truth) / static_cast<double>(corners.size());
  }
  std::sort(errors.begin(), errors.end());
  std::printf("%s: %zu corners, median %.3f px, 90th percentile %.3f px, mean (%.3f, %.3f) px\n",
              who, errors.size(), errors[errors.size() / 2], errors[errors.size() * 9 / 10],
              mean.x(), mean.y());
  // Refinement on noisy pictures is good to some hundredths; a half-pixel convention mixed up, a
  // board drawn mirrored, unbent or blurred unevenly is not.
  EXPECT_LT(errors[errors.size() / 2], 0.1) << who;
  EXPECT_LT(mean.norm(), 0.03) << who;
}

TEST(RigPrograms, BoardsCornersAreWhereAProjectionPutsThem) {
  Bench& b = bench();
  const double start = b.begin(RigProgram::kBoard);
  const auto stops = stopsOf(b.play.board);
  ASSERT_GT(stops.size(), 100u);  // for two source cameras
  std::vector<SeenCorner> byScene, byFirst, bySecond;
  for (std::size_t i = 0; i < stops.size(); i += 5) {
    const Eigen::Isometry3d pose = b.play.board.sceneFromBoardAt(stops[i]);
    const auto collect = [&](FrameSource& view, const Vector3d& eye, const auto& project,
                             std::vector<SeenCorner>& into) {
      const auto seen =
          refined(b.picture(view, start + stops[i]), b.play.board, pose, eye, project);
      into.insert(into.end(), seen.begin(), seen.end());
    };
    collect(
        b.scene, b.stillLife->sceneFromCamera().translation(),
        [&](const Vector3d& p) { return std::optional(b.scenePixel(p)); }, byScene);
    collect(
        b.first, b.first.sceneFromCamera().translation(),
        [&](const Vector3d& p) {
          return FisheyeLens(kFirstLens).project(b.first.sceneFromCamera().inverse() * p);
        },
        byFirst);
    collect(
        b.second, b.second.sceneFromCamera().translation(),
        [&](const Vector3d& p) {
          return FisheyeLens(kSecondLens).project(b.second.sceneFromCamera().inverse() * p);
        },
        bySecond);
  }
  expectAgreement(byScene, 60, "scene camera");
  expectAgreement(byFirst, 300, "first source camera");
  expectAgreement(bySecond, 300, "second source camera");
}

TEST(RigPrograms, MarkersAreOpenCvsAndCornersAreNumberedAsOpenCvDoes) {
  Bench& b = bench();
  const double start = b.begin(RigProgram::kBoard);
  const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_5X5_250);
  const auto charuco = cv::aruco::CharucoBoard::create(11, 8, 0.03f, 0.0225f, dictionary);
  const double t = stopsOf(b.play.board).front();
  const cv::Mat grey = b.picture(b.first, start + t);
  std::vector<std::vector<cv::Point2f>> markers;
  std::vector<int> ids, numbers;
  cv::aruco::detectMarkers(grey, dictionary, markers, ids);
  EXPECT_GT(ids.size(), 35u);
  std::vector<cv::Point2f> corners;
  cv::aruco::interpolateCornersCharuco(markers, ids, grey, charuco, corners, numbers);
  ASSERT_GT(corners.size(), 50u);
  const Eigen::Isometry3d pose = b.play.board.sceneFromBoardAt(t);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Vector3d corner = pose * b.play.board.corner(numbers[i] % 10, numbers[i] / 10);
    const auto truth = b.first.lens().project(b.first.sceneFromCamera().inverse() * corner);
    ASSERT_TRUE(truth);
    // OpenCV's interpolation is coarse; a square is 30 px wide.
    EXPECT_LT((Vector2d(corners[i].x, corners[i].y) - *truth).norm(), 2) << numbers[i];
  }
}

TEST(RigPrograms, BoardReachesTheRimAllAround) {
  const Bench& b = bench();
  for (const SourceView* view : {&b.first, &b.second}) {
    std::array<double, 24> outermost{};  // degrees, by 15 degrees of azimuth
    for (const double t : stopsOf(b.play.board)) {
      const Eigen::Isometry3d pose = b.play.board.sceneFromBoardAt(t);
      const Vector3d front = -pose.linear().col(2);
      for (int row = 0; row < 7; ++row) {
        for (int column = 0; column < 10; ++column) {
          const Vector3d corner = pose * b.play.board.corner(column, row);
          const Vector3d p = view->sceneFromCamera().inverse() * corner;
          const Vector3d eye = view->sceneFromCamera().translation();
          const double theta = std::atan2(std::hypot(p.x(), p.y()), p.z()) * 180 / std::numbers::pi;
          if (theta > 92.5 || front.dot((eye - corner).normalized()) < 0.4 || p.norm() > 0.4) {
            continue;
          }
          const double azimuth = std::atan2(p.y(), p.x()) / (2 * std::numbers::pi) + 1;
          auto& most = outermost[static_cast<std::size_t>(24 * azimuth) % 24];
          most = std::max(most, theta);
        }
      }
    }
    // Rows of corners are eight degrees apart; several heights put one within 3.5 of the rim.
    EXPECT_GT(*std::min_element(outermost.begin(), outermost.end()), 89);
  }
}

TEST(RigPrograms, BoardStaysOffTheTableAndReturns) {
  const Bench& b = bench();
  const HeldBoard& board = b.play.board;
  for (const double t : stopsOf(board)) {
    const Eigen::Isometry3d pose = board.sceneFromBoardAt(t);
    for (const double x : {-0.03, 0.30}) {
      for (const double y : {-0.03, 0.21}) {
        EXPECT_GT((pose * Vector3d(x, y, 0)).z(), b.stillLife->tableHeight() - 0.002);
      }
    }
  }
  EXPECT_TRUE(
      board.sceneFromBoardAt(1.2).isApprox(board.sceneFromBoardAt(1.2 + board.periodSeconds())));
}

// --- The mirror ball ----------------------------------------------------------------------------

// Where light goes from lamp to eye by way of the ball: the shortest way over its surface (Fermat),
// found by descent over the sphere alone, with no word of normals and angles.
Vector3d fermatPoint(const ChromeBall& ball, const Vector3d& eye, const Vector3d& lamp) {
  const auto length = [&](const Vector3d& p) { return (eye - p).norm() + (lamp - p).norm(); };
  Vector3d best =
      ((eye - ball.centre).normalized() + (lamp - ball.centre).normalized()).normalized();
  double step = 0.3;
  while (step > 1e-9) {
    const Vector3d u = best.unitOrthogonal(), v = best.cross(u);
    bool better = false;
    for (const auto& [a, c] : {std::pair(1, 0), {-1, 0}, {0, 1}, {0, -1}}) {
      const Vector3d tried = (best + step * (a * u + c * v)).normalized();
      if (length(ball.centre + ball.radius * tried) < length(ball.centre + ball.radius * best)) {
        best = tried;
        better = true;
        break;
      }
    }
    if (!better) step /= 2;
  }
  return ball.centre + ball.radius * best;
}

TEST(RigPrograms, LampsHighlightOnTheBallTakesTheShortestWay) {
  Bench& b = bench();
  const double start = b.begin(RigProgram::kMirrorBall);
  const Vector3d eye = b.stillLife->sceneFromCamera().translation();
  double worst = 0;
  constexpr int kLamps = 24;
  for (int i = 0; i < kLamps; ++i) {
    const double z = 0.15 + 0.8 * (i + 0.5) / kLamps, azimuth = 2.39996 * i;
    const double r = std::sqrt(1 - z * z), distance = 0.6 + 0.9 * i / kLamps;
    b.lamp.state.position = distance * Vector3d(r * std::cos(azimuth), r * std::sin(azimuth), z);
    const Vector2d expected = b.scenePixel(fermatPoint(b.play.ball, eye, b.lamp.state.position));
    const RadianceImage& picture = b.scene.render(start + 1, 0.02);
    // Centroid of what is far brighter than anything but lights.
    Vector2d sum = Vector2d::Zero();
    double weight = 0;
    for (int y = static_cast<int>(expected.y()) - 6; y <= expected.y() + 6; ++y) {
      for (int x = static_cast<int>(expected.x()) - 6; x <= expected.x() + 6; ++x) {
        const double value = std::max(0.0, picture(x, y, 1) - 3.0);
        sum += value * Vector2d(x + 0.5, y + 0.5);
        weight += value;
      }
    }
    ASSERT_GT(weight, 100) << i;
    worst = std::max(worst, (sum / weight - expected).norm());
  }
  b.lamp.state.position = Vector3d(0, 0, 0.9);
  std::printf("highlight against Fermat's point: at most %.3f px\n", worst);
  // The lamp's image is no point: its centroid lies off its centre's image by the curvature of the
  // ball, some hundredths of a pixel. A degree of lamp direction moves it by 0.7 px.
  EXPECT_LT(worst, 0.08);
}

// --- Diffuser, lens cap, brackets ---------------------------------------------------------------

double meanSignal(const std::vector<std::uint8_t>& bytes, PixelFormat format, int left, int top,
                  int side, int width) {
  const PixelFormatInfo& info = pixelFormatInfo(format);
  double sum = 0;
  for (int y = top; y < top + side; ++y) {
    for (int x = left; x < left + side; ++x) {
      const auto at =
          static_cast<std::size_t>((y * width + x) * static_cast<int>(info.bytesPerPixel));
      sum += info.bits > 8 ? bytes[at] + 256 * bytes[at + 1] : bytes[at];
    }
  }
  const double black = blackLevelCounts(format);
  return (sum / (side * side) - black) / ((1 << info.bits) - 1 - black);
}

TEST(RigPrograms, BracketsOfTheStillSceneAreLinearOverFourDecades) {
  Bench& b = bench();
  const double start = b.begin(RigProgram::kStill);
  // A patch of wood in the room's light, 12 bits, and one of ceiling before the source camera.
  const auto scene = [&](double seconds) {
    return meanSignal(Bench::expose(b.scene, PixelFormat::kBayerRG12, start + 1, seconds),
                      PixelFormat::kBayerRG12, 280, 4, 48, 640);
  };
  const auto source = [&](double seconds) {
    return meanSignal(Bench::expose(b.first, PixelFormat::kMono12, start + 1, seconds),
                      PixelFormat::kMono12, 500, 420, 48, 960);
  };
  // The longest exposures come near to saturation, the shortest hold a few counts at most: there
  // the mean of 2304 samples is good to 0.00001 of the range.
  const double longScene = 1.0, longSource = 0.01;
  const double sceneRate = scene(longScene) / longScene;
  const double sourceRate = source(longSource) / longSource;
  EXPECT_GT(scene(longScene), 0.2);
  EXPECT_LT(scene(longScene), 0.95);
  EXPECT_GT(source(longSource), 0.2);
  EXPECT_LT(source(longSource), 0.95);
  for (const double share : {0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0001}) {
    EXPECT_NEAR(scene(share * longScene), share * longScene * sceneRate,
                0.005 * share * longScene * sceneRate + 0.00006)
        << share;
    EXPECT_NEAR(source(share * longSource), share * longSource * sourceRate,
                0.005 * share * longSource * sourceRate + 0.00012)
        << share;
  }
}

TEST(RigPrograms, NothingMovesInTheStillScene) {
  Bench& b = bench();
  const double start = b.begin(RigProgram::kStill);
  const auto scene = b.scene.render(start + 1, 0.02);
  const auto source = b.first.render(start + 1, 0.001);
  b.lamp.state.position = Vector3d(0.5, 0.2, 0.6);
  EXPECT_TRUE(std::equal(scene.data(), scene.data() + 640 * 480 * 3,
                         b.scene.render(start + 9, 0.02).data()));
  EXPECT_EQ(source, b.first.render(start + 9, 0.001));
  b.lamp.state.position = Vector3d(0, 0, 0.9);
}

TEST(RigPrograms, DiffuserShowsTheLensAndTheCapDarkness) {
  Bench& b = bench();
  double start = b.begin(RigProgram::kDiffuser);
  const auto white = Bench::expose(b.first, PixelFormat::kMono12, start + 1, 0.001);
  // Relative illumination 1 - 0.5 (theta / 92.5 degrees)^3 at three places, against the centre's.
  const double middle = meanSignal(white, PixelFormat::kMono12, 475, 468, 16, 960);
  EXPECT_GT(middle, 0.4);
  EXPECT_LT(middle, 0.7);
  for (const double theta : {30.0, 60.0, 85.0}) {
    const double t = theta * std::numbers::pi / 180;
    const auto pixel = b.first.lens().project({std::sin(t), 0, std::cos(t)});
    const double there = meanSignal(white, PixelFormat::kMono12, static_cast<int>(pixel->x()) - 4,
                                    static_cast<int>(pixel->y()) - 4, 8, 960);
    // 64 samples of a noise of one percent.
    EXPECT_NEAR(there / middle, 1 - 0.5 * std::pow(theta / 92.5, 3), 0.012) << theta;
  }
  start = b.begin(RigProgram::kDark);
  EXPECT_NEAR(meanSignal(Bench::expose(b.scene, PixelFormat::kBayerRG12, start + 1, 0.02),
                         PixelFormat::kBayerRG12, 100, 100, 200, 640),
              0, 0.0001);
}

TEST(RigPrograms, NamesGoBothWays) {
  for (int i = 0; i < kRigProgramCount; ++i) {
    const auto program = static_cast<RigProgram>(i);
    EXPECT_EQ(rigProgramFromName(std::string(rigProgramName(program))), program);
  }
  EXPECT_FALSE(rigProgramFromName("disco"));
}

// --- Sensors with flaws -------------------------------------------------------------------------

TEST(SensorFlaws, ResponseAccessorInvertsWhatTheSensorDoes) {
  std::vector<float> signal(4000);
  for (const float light : {0.002f, 0.02f, 0.2f, 0.8f}) {
    std::fill(signal.begin(), signal.end(), light);
    std::vector<std::uint8_t> counts(signal.size());
    readOut({1e9, 0}, PixelFormat::kMono8, 0, 7, signal, counts.data(), EightBitResponse::kSrgb);
    double mean = 0;
    for (const auto c : counts) mean += static_cast<double>(c) / static_cast<double>(counts.size());
    const double back = signalOfCounts(EightBitResponse::kSrgb, PixelFormat::kMono8, mean);
    // Half a count of rounding; the curve's slope says how much light that is.
    const double step =
        signalOfCounts(EightBitResponse::kSrgb, PixelFormat::kMono8, mean + 0.55) - back;
    EXPECT_NEAR(back, light, step) << light;
  }
  // Other formats stay linear: 64 counts of 4095 are black.
  EXPECT_NEAR(signalOfCounts(EightBitResponse::kSrgb, PixelFormat::kMono12, 64 + 4031 * 0.25), 0.25,
              1e-12);
}

TEST(SensorFlaws, HotPixelsLeakWithTheExposureAndAreThoseInTheList) {
  SensorFlaws flaws;
  flaws.hotPixels = 50;
  flaws.darkCurrent = 0.01;
  const FlawedPixels pixels(64, 48, flaws, 3);
  EXPECT_EQ(pixels.hotPixels().size(), 50u);
  const auto dark = [&](double seconds) {
    std::vector<float> signal(64 * 48, 0.0f);
    pixels.collect({0, 0, 64, 48}, 1, seconds, signal);
    return signal;
  };
  const auto once = dark(0.1), twice = dark(0.2);
  std::vector<char> listed(64 * 48, 0);
  for (const auto& p : pixels.hotPixels()) listed[static_cast<std::size_t>(64 * p.y() + p.x())] = 1;
  for (std::size_t i = 0; i < once.size(); ++i) {
    EXPECT_NEAR(twice[i], 2 * once[i], 1e-5);
    EXPECT_EQ(once[i] > 0.0101f, listed[i] == 1) << i;
  }
}

TEST(SensorFlaws, VignettingAndPixelGainsAreAsAsked) {
  SensorFlaws flaws;
  flaws.vignetting = 0.4;
  flaws.prnu = 0.01;
  const FlawedPixels pixels(200, 100, flaws, 3);
  std::vector<float> signal(200 * 100, 1.0f);
  pixels.collect({0, 0, 200, 100}, 1, 0.01, signal);
  EXPECT_NEAR(pixels.falloff({100, 50}), 1, 1e-12);
  EXPECT_NEAR(pixels.falloff({0, 0}), 0.6, 1e-12);
  double sum = 0, squares = 0;
  for (std::size_t i = 0; i < signal.size(); ++i) {
    const double gain = signal[i] / pixels.falloff({static_cast<double>(i % 200) + 0.5,
                                                    static_cast<double>(i / 200) + 0.5});
    sum += gain;
    squares += gain * gain;
  }
  const double mean = sum / 20000, rms = std::sqrt(squares / 20000 - mean * mean);
  EXPECT_NEAR(mean, 1, 0.0003);  // four sigmas of 20000 gains
  EXPECT_NEAR(rms, 0.01, 0.0003);
}

}  // namespace
}  // namespace lightsketch
