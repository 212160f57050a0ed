// Response recovery and exposure merging against OpenCV in the same run, simulated and on the
// memorial church. bench_radiometry [PNG]: where to put the tone-mapped memorial picture.
#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <numeric>
#include <opencv2/core.hpp>
#include <opencv2/photo.hpp>

#include "calibration/radiometry/response_calibration.h"
#include "calibration/radiometry/response_file.h"
#include "pipeline/hdr/merge.h"
#include "pipeline/sketch/image_file.h"
#include "tests/calibration/radiometry/simulated_sensor.h"

using namespace lightsketch;

namespace {

double secondsOf(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

struct CvBracket {
  std::vector<cv::Mat> pictures;
  std::vector<float> times;
};

CvBracket forOpenCv(const std::vector<Frame>& frames) {
  CvBracket bracket;
  for (const Frame& frame : frames) {
    bracket.pictures.push_back(
        cv::Mat(frame.height, frame.width, CV_8UC3, const_cast<std::uint8_t*>(frame.bytes.data()))
            .clone());
    bracket.times.push_back(static_cast<float>(frame.metadata.exposureSeconds));
  }
  return bracket;
}

cv::Mat tableOf(const std::function<double(int count, int colour)>& exposure) {
  cv::Mat table(256, 1, CV_32FC3);
  for (int count = 0; count < 256; ++count) {
    for (int c = 0; c < 3; ++c) {
      table.at<cv::Vec3f>(count)[c] = static_cast<float>(std::max(exposure(count, c), 1e-6));
    }
  }
  return table;
}

// rms of the relative error of a response against sRGB, best common factor taken off.
double responseError(const std::function<double(int)>& exposure, int low, int high) {
  double mean = 0, square = 0;
  const double n = high - low + 1;
  for (int count = low; count <= high; ++count) {
    const double e = std::log(exposure(count) / srgbLight(count / 255.0));
    mean += e / n;
    square += e * e / n;
  }
  return 100 * std::sqrt(std::max(square - mean * mean, 0.0));
}

bool monotone(const std::function<double(int)>& exposure) {
  for (int count = 1; count < 256; ++count) {
    if (!(exposure(count) > exposure(count - 1))) return false;
  }
  return true;
}

// Mean absolute and rms relative error of a merge over the simulated scene, best factor taken off.
void printMerge(const char* name, const SimulatedSensor& sensor,
                const std::function<double(int x, int y, int c)>& merged, double seconds) {
  std::vector<double> errors;
  for (int y = 0; y < sensor.height; ++y) {
    for (int x = 0; x < sensor.width; ++x) {
      for (int c = 0; c < 3; ++c) {
        const double e = std::log(std::max(merged(x, y, c), 1e-9) / fourDecades(sensor, x, y));
        if (std::isfinite(e)) errors.push_back(e);
      }
    }
  }
  const double n = static_cast<double>(errors.size());
  const double mean = std::accumulate(errors.begin(), errors.end(), 0.0) / n;
  double absolute = 0, square = 0;
  for (const double e : errors) {
    absolute += std::abs(std::expm1(e - mean)) / n;
    square += std::pow(std::expm1(e - mean), 2) / n;
  }
  fmt::print("  {:<44} {:6.2f} % mean  {:6.2f} % rms  {:7.3f} s\n", name, 100 * absolute,
             100 * std::sqrt(square), seconds);
}

void simulated() {
  SimulatedSensor sensor;
  sensor.response = srgbSignal;
  std::vector<Frame> frames;
  for (int i = -4; i <= 4; ++i) {
    frames.push_back(sensor.expose([&](int x, int y, int) { return fourDecades(sensor, x, y); },
                                   std::pow(2.0, i), static_cast<unsigned>(i + 5)));
  }
  const CvBracket cvBracket = forOpenCv(frames);

  fmt::print(
      "Response of an 8-bit camera with sRGB's curve, 9 exposures 2x apart, 15000 e, 8 e read "
      "noise\n  rms relative error, best factor taken off; bar 0.5 % over counts 20..235\n");
  ResponseCalibration ours;
  const double ourSeconds = secondsOf([&] {
    auto result = calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
    if (!result) throw std::runtime_error(result.error().message);
    ours = *result;
  });
  const ResponseCurve& curve = ours.sensor.response;
  for (int c = 0; c < 3; ++c) {
    const auto exposure = [&](int count) { return curve.exposure(count, c); };
    fmt::print(
        "  lightsketch, colour {}         20..235: {:5.2f} %   10..250: {:5.2f} %   monotone: "
        "{}   {:.2f} s\n",
        c, responseError(exposure, 20, 235), responseError(exposure, 10, 250),
        monotone(exposure) ? "yes" : "no", ourSeconds);
  }
  cv::Mat debevec, robertson;
  const double debevecSeconds = secondsOf([&] {
    cv::createCalibrateDebevec(144, 10, true)
        ->process(cvBracket.pictures, debevec, cvBracket.times);
  });
  const double robertsonSeconds = secondsOf([&] {
    cv::createCalibrateRobertson()->process(cvBracket.pictures, robertson, cvBracket.times);
  });
  for (const auto& [name, table, seconds] :
       {std::tuple{"OpenCV Debevec", debevec, debevecSeconds},
        std::tuple{"OpenCV Robertson", robertson, robertsonSeconds}}) {
    const auto exposure = [&t = table](int count) {
      return static_cast<double>(t.at<cv::Vec3f>(count)[1]);
    };
    fmt::print("  {:<29} 20..235: {:5.2f} %   10..250: {:5.2f} %   monotone: {}   {:.2f} s\n", name,
               responseError(exposure, 20, 235), responseError(exposure, 10, 250),
               monotone(exposure) ? "yes" : "no", seconds);
  }

  fmt::print("Merge of these over 4 decades; bar 2.5 % mean\n");
  auto truth = std::make_shared<SensorModel>(ours.sensor);
  std::vector<double> table;
  for (int count = 0; count < 256; ++count) table.push_back(srgbLight(count / 255.0));
  truth->response = ResponseCurve::tabulated({table, table, table}, 255, 255).value();
  truth->noise.channels = {{sensor.fullWell, sensor.readNoise}};
  const auto calibrated = std::make_shared<SensorModel>(ours.sensor);
  for (const auto& [name, model] : {std::pair{"true response: lightsketch", truth},
                                    std::pair{"calibrated response: lightsketch", calibrated}}) {
    RadianceMap map;
    const double seconds = secondsOf([&, &m = model] {
      auto merged = mergeExposures(frames, {.sensor = m});
      if (!merged) throw std::runtime_error(merged.error().message);
      map = std::move(*merged);
    });
    printMerge(
        name, sensor,
        [&](int x, int y, int c) { return static_cast<double>(map.radiance(x, y, c)); }, seconds);
  }
  const cv::Mat exact = tableOf([](int count, int) { return srgbLight(count / 255.0); });
  const cv::Mat found = tableOf([&](int count, int c) { return curve.exposure(count, c); });
  const auto cvMerge = [&](const std::string& name, bool useDebevec, const cv::Mat& response) {
    cv::Mat picture;
    const double seconds = secondsOf([&] {
      if (useDebevec) {
        cv::createMergeDebevec()->process(cvBracket.pictures, picture, cvBracket.times, response);
      } else {
        cv::createMergeRobertson()->process(cvBracket.pictures, picture, cvBracket.times, response);
      }
    });
    printMerge(
        name.c_str(), sensor,
        [&](int x, int y, int c) { return static_cast<double>(picture.at<cv::Vec3f>(y, x)[c]); },
        seconds);
  };
  cvMerge("true response: OpenCV Debevec", true, exact);
  cvMerge("true response: OpenCV Robertson", false, exact);
  cvMerge("OpenCV's own response: OpenCV Debevec", true, debevec);
  cvMerge("OpenCV's own response: OpenCV Robertson", false, robertson);
  cvMerge("lightsketch's response: OpenCV Debevec", true, found);
  cvMerge("lightsketch's response: OpenCV Robertson", false, found);
}

void memorial(const std::filesystem::path& folder, const std::filesystem::path& png) {
  if (!std::filesystem::exists(folder)) {
    fmt::print("{} is not here: the memorial bracket was not measured\n", folder.string());
    return;
  }
  auto frames = readBracketFolder(folder).value();
  fmt::print("Memorial church, {} exposures of {} x {}\n", frames.size(), frames[0].width,
             frames[0].height);
  ResponseCalibration ours;
  const double calibration = secondsOf([&] {
    auto result = calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
    if (!result) throw std::runtime_error(result.error().message);
    ours = *result;
  });
  fmt::print("{}", ours.summary.text(ours.sensor));
  if (ours.summary.timesEstimated) {
    for (const auto& e : ours.summary.exposures)
      fmt::print("  {:g} s {:+.1f} %", e.seconds, 100 * e.timeError);
    fmt::print("\n");
  }
  for (int c = 0; c < 3; ++c) {
    fmt::print("  colour {}: response monotone: {}\n", c,
               monotone([&](int count) { return ours.sensor.response.exposure(count, c); }) ? "yes"
                                                                                            : "no");
  }
  const auto sensor = std::make_shared<SensorModel>(ours.sensor);
  RadianceMap map;
  const double merge = secondsOf([&] { map = mergeExposures(frames, {.sensor = sensor}).value(); });
  fmt::print("  calibrated in {:.2f} s, merged in {:.2f} s, {:.3f} % saturated everywhere\n",
             calibration, merge, 100 * map.saturatedFraction);

  const CvBracket cvBracket = forOpenCv(frames);
  const auto compare = [&](const char* name, bool useDebevec) {
    cv::Mat response, picture;
    const double seconds = secondsOf([&] {
      if (useDebevec) {
        cv::createCalibrateDebevec(144, 10, true)
            ->process(cvBracket.pictures, response, cvBracket.times);
        cv::createMergeDebevec()->process(cvBracket.pictures, picture, cvBracket.times, response);
      } else {
        cv::createCalibrateRobertson()->process(cvBracket.pictures, response, cvBracket.times);
        cv::createMergeRobertson()->process(cvBracket.pictures, picture, cvBracket.times, response);
      }
    });
    for (int c = 0; c < 3; ++c) {
      std::vector<double> ratios;
      for (int y = 0; y < frames[0].height; ++y) {
        for (int x = 0; x < frames[0].width; ++x) {
          const double r = std::log(static_cast<double>(picture.at<cv::Vec3f>(y, x)[c]) /
                                    static_cast<double>(map.radiance(x, y, c)));
          if (std::isfinite(r)) ratios.push_back(r);
        }
      }
      std::ranges::sort(ratios);
      const auto at = [&](double q) {
        return ratios[static_cast<std::size_t>(q * static_cast<double>(ratios.size() - 1))];
      };
      fmt::print(
          "  against {:<17} colour {}: ln ratio, median taken off: half within {:.3f}, 90 % "
          "within {:+.3f} .. {:+.3f}; {:.2f} s\n",
          name, c, 0.5 * (at(0.75) - at(0.25)), at(0.05) - at(0.5), at(0.95) - at(0.5), seconds);
    }
  };
  compare("OpenCV Debevec", true);
  compare("OpenCV Robertson", false);

  // Reinhard et al. 2002, eq. 3 and 4: exposed by the log mean, compressed by L / (1 + L).
  double logMean = 0;
  for (const float v : map.radiance.values()) logMean += std::log(1e-6 + std::max(0.0f, v));
  const double key = 0.18 / std::exp(logMean / static_cast<double>(map.radiance.size()));
  for (float& v : map.radiance.values()) {
    const double scaled = key * static_cast<double>(std::max(0.0f, v));
    v = static_cast<float>(scaled / (1 + scaled));
  }
  if (!png.empty() && writePng(png, map.radiance)) fmt::print("  tone-mapped: {}\n", png.string());
}

}  // namespace

int main(int argc, char** argv) {
  try {
    simulated();
    memorial(std::filesystem::path(LIGHTSKETCH_SOURCE_DIR) / "../shared/data/hdr/memorial",
             argc > 1 ? argv[1] : "");
  } catch (const std::exception& error) {
    fmt::print(stderr, "bench_radiometry: {}\n", error.what());
    return 1;
  }
}
