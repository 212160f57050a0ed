#include "calibration/lens/lens_report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

// A calibration with known figures, no solver behind it.
LensCalibration invented() {
  FisheyeParameters f;
  f.width = 640;
  f.height = 480;
  f.fx = f.fy = 200;
  f.cx = 320;
  f.cy = 240;
  f.maxFieldAngle = Angle::degrees(95);
  LensUncertainty uncertainty;
  uncertainty.covariance = Eigen::MatrixXd::Zero(18, 18);
  uncertainty.covariance(0, 0) = uncertainty.covariance(1, 1) = 0.04;
  uncertainty.covariance(4, 4) = 1e-6;
  uncertainty.modelError = Angle::degrees(0.02);
  uncertainty.coveredField.assign(36, Angle::degrees(80));
  uncertainty.coveredField[7] = Angle::degrees(62);
  LensCalibration calibration;
  calibration.model = *FisheyeModel::create(f, uncertainty);
  calibration.splitHalf = {10,
                           Angle::degrees(0.123),
                           Angle::degrees(0.4),
                           Angle::degrees(0.111),
                           {Angle::degrees(0.05), Angle::degrees(NAN)}};
  calibration.advice = {"hold the board to the <left> edge"};
  calibration.warnings = {"the edge of the field, beyond 62 degrees, is unknown"};
  calibration.trials = {{LensFamily::kKannalaBrandt, 0.25, Angle::degrees(0.1), true},
                        {LensFamily::kFisheye624, 0.26, Angle::degrees(0.2), false}};
  calibration.residualPixels = 0.217;
  for (int v = 0; v < 3; ++v) {
    ViewResult view;
    view.name = "view" + std::to_string(v) + ".png";
    for (int i = 0; i < 12; ++i) {
      CornerResidual corner;
      corner.column = i % 4;
      corner.row = i / 4;
      const double theta = (10 + 20 * v + i) * kDegree;
      const Eigen::Vector3d direction(std::sin(theta) * std::cos(i), std::sin(theta) * std::sin(i),
                                      std::cos(theta));
      corner.pixel = *calibration.model->project(direction);
      corner.residual = {0.1, -0.2};
      corner.fieldAngle = Angle::radians(theta);
      view.corners.push_back(corner);
    }
    calibration.views.push_back(view);
  }
  calibration.views[1].corners[5].rejected = "8.1 robust sigmas off";
  calibration.views[2].rejected = "the board is seen from behind";
  calibration.viewsUsed = 2;
  calibration.cornersUsed = 23;
  return calibration;
}

LensReport inventedReport() {
  LensReport report;
  report.title = "cam <1> & co";
  report.calibration = invented();
  BoardDetection dark;
  dark.view.name = "dark.png";
  dark.reason = "no grid of 12 or more corners";
  report.pictures.push_back(dark);
  return report;
}

bool contains(const std::string& page, std::string_view text) {
  return page.find(text) != std::string::npos;
}

// Every element that is opened is closed, in order: what a browser would otherwise mend silently.
std::string firstUnbalanced(const std::string& page) {
  std::vector<std::string> open;
  for (std::size_t at = page.find('<'); at != std::string::npos; at = page.find('<', at + 1)) {
    const std::size_t end = page.find('>', at);
    if (end == std::string::npos) return page.substr(at, 40);
    const std::string tag = page.substr(at + 1, end - at - 1);
    if (tag.starts_with('!') || tag.ends_with('/')) continue;
    const std::string name = tag.substr(0, tag.find_first_of(" \n"));
    if (name == "meta" || name == "br") continue;
    if (!name.starts_with('/')) {
      open.push_back(name);
    } else if (open.empty() || open.back() != name.substr(1)) {
      return tag + " at " + page.substr(at > 60 ? at - 60 : 0, 100);
    } else {
      open.pop_back();
    }
  }
  return open.empty() ? std::string() : "open: " + open.back();
}

TEST(LensReport, SaysHowFarTheLensCanBeTrusted) {
  const std::string page = lensReportHtml(inventedReport());
  EXPECT_TRUE(contains(page, "0.123"));       // halves differ
  EXPECT_TRUE(contains(page, "0.111"));       // as predicted
  EXPECT_TRUE(contains(page, "1.11 times"));  // and their ratio
  EXPECT_TRUE(contains(page, "62.0° to 80.0°"));
  EXPECT_TRUE(contains(page, "beyond 62 degrees, is unknown"));
  EXPECT_TRUE(contains(page, "hold the board to the &lt;left&gt; edge"));
  EXPECT_TRUE(contains(page, "Kannala-Brandt"));
  // The residual stands with what it does not say.
  EXPECT_TRUE(contains(page, "0.217"));
  EXPECT_TRUE(contains(page, "small residual does not make a lens right"));
}

TEST(LensReport, PredictedUncertaintyIsThatOfTheModel) {
  // One covered direction per ring is enough for a lens without azimuth: 0.2 px of 200 px focal
  // length is 1e-3 of theta off at any angle, less what a rotation takes; k0's 1e-3 theta^3 adds.
  const auto report = inventedReport();
  const auto& model = *report.calibration.model;
  const double theta = 72.5 * kDegree;
  const double sigma =
      std::sqrt(model.directionCovariance({std::sin(theta), 0, std::cos(theta)}).trace()) / kDegree;
  const std::string page = lensReportHtml(report);
  const auto row = page.find("<td>70° to 75°</td>");
  ASSERT_NE(row, std::string::npos);
  const auto cell = page.find("<td>", page.find("<td>", row + 5) + 5);
  // fx and fy err apart, so the ring's rms is within a few percent of one azimuth's.
  EXPECT_NEAR(std::stod(page.substr(cell + 4)), sigma, 0.15 * sigma);
}

TEST(LensReport, ListsWhatWasThrownOutAndWhy) {
  const std::string page = lensReportHtml(inventedReport());
  EXPECT_TRUE(contains(page, "8.1 robust sigmas off"));
  EXPECT_TRUE(contains(page, "the board is seen from behind"));
  EXPECT_TRUE(contains(page, "dark.png"));
  EXPECT_TRUE(contains(page, "no grid of 12 or more corners"));
}

TEST(LensReport, ShowsMrcalsOpinionWhereThereIsOne) {
  auto report = inventedReport();
  EXPECT_FALSE(contains(lensReportHtml(report), "mrcal solved"));
  MrcalCheck check;
  check.lens = "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3";
  check.rms = Angle::degrees(0.0654);
  check.largest = Angle::degrees(0.321);
  check.byFieldAngle.assign(10, Angle::degrees(0.05));
  report.mrcal = check;
  const std::string page = lensReportHtml(report);
  EXPECT_TRUE(contains(page, "0.065"));
  EXPECT_TRUE(contains(page, "0.321"));
}

TEST(LensReport, IsOneWellFormedPageThatLoadsNothing) {
  const std::string page = lensReportHtml(inventedReport());
  EXPECT_EQ(firstUnbalanced(page), "");
  EXPECT_TRUE(contains(page, "cam &lt;1&gt; &amp; co"));
  for (const char* foreign : {"<script", "http:", "https:", "src=", "nan", "inf "}) {
    EXPECT_FALSE(contains(page, foreign)) << foreign;
  }
}

TEST(LensReport, SurvivesACalibrationThatKnowsLittle) {
  LensReport report;
  report.title = "bare";
  report.calibration = invented();
  auto values = report.calibration.model->values();
  report.calibration.model = *FisheyeModel::create(values);
  report.calibration.views.clear();
  report.calibration.trials.clear();
  report.calibration.splitHalf = {};
  const std::string page = lensReportHtml(report);
  EXPECT_EQ(firstUnbalanced(page), "");
  EXPECT_FALSE(contains(page, "nan"));
}

TEST(LensReport, IsWrittenAsAFile) {
  const TemporaryFolder folder;
  ASSERT_TRUE(writeLensReport(inventedReport(), folder / "lens.html"));
  EXPECT_EQ(contentOf(folder / "lens.html"), lensReportHtml(inventedReport()));
  EXPECT_EQ(writeLensReport(inventedReport(), folder / "absent" / "lens.html").error().code,
            ErrorCode::kNotFound);
}

}  // namespace
}  // namespace lightsketch
