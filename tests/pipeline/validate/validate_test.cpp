#include "pipeline/validate/validate.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>

#include "pipeline/compress/compress.h"
#include "pipeline/illumination/illumination.h"
#include "pipeline/validate/metrics.h"
#include "synthetic.h"

namespace lightsketch {
namespace {

using testing::constantPicture;
using testing::exactModel;
using testing::kHeight;
using testing::kWidth;
using testing::makeSketch;
using testing::mattePicture;
using testing::TemporaryFolder;

constexpr const char* kRule = "every:8:4";
constexpr int kFrames = 40;  // holds out 4, 12, 20, 28, 36

class Validate : public ::testing::Test {
 protected:
  Result<ValidationReport> run(const RelightableModel& model, const ValidateOptions& options = {}) {
    SilentProgress progress;
    return validate(sketch_, model, options, progress);
  }
  std::string refusal(const RelightableModel& model, const ValidateOptions& options = {}) {
    const auto report = run(model, options);
    return report ? "accepted" : report.error().message;
  }

  TemporaryFolder folder_;
  Sketch sketch_ = makeSketch(folder_.path() / "sketch", mattePicture, kFrames);
  RelightableModel model_ = exactModel(sketch_, mattePicture, kRule);
};

TEST_F(Validate, AModelThatPredictsExactlyIsReportedIdentical) {
  const Sketch sketch = makeSketch(folder_.path() / "constant", constantPicture, kFrames);
  const RelightableModel model = exactModel(sketch, constantPicture, kRule);
  SilentProgress progress;
  const auto report = validate(sketch, model, {}, progress);
  ASSERT_TRUE(report) << report.error().message;
  ASSERT_EQ(report->lights.size(), 5u);
  for (const HeldOutLight& light : report->lights) {
    EXPECT_TRUE(light.error.identical);
    EXPECT_EQ(light.error.psnr, kPsnrCap);
    EXPECT_NEAR(light.error.ssim.value(), 1, 1e-12);
    EXPECT_LT(light.error.relative, 1e-5);  // float weights that add up to 1
  }
  EXPECT_EQ(report->all.psnr, kPsnrCap);
  EXPECT_EQ(toJson(*report)["lights"][0]["identical"], true);
}

TEST_F(Validate, AnExactModelOfALinearSceneErrsByTheCapturesRoundingOnly) {
  const auto report = run(model_);
  ASSERT_TRUE(report) << report.error().message;
  EXPECT_EQ(report->captured, kFrames - 5);
  std::vector<int> ids;
  for (const auto& light : report->lights) ids.push_back(light.id);
  EXPECT_EQ(ids, (std::vector<int>{4, 12, 20, 28, 36}));
  // Frames are half floats: relative rounding at most 2^-11, of which the rms is a fraction. A
  // smooth interpolation reproduces functions of its trend, here the linear ones.
  EXPECT_LT(report->all.relative, 5e-4);
  EXPECT_GT(report->all.psnr, 55);
  EXPECT_GT(report->all.ssim.value(), 0.9999);
  EXPECT_GT(report->all.linearPsnr, 60);
}

TEST_F(Validate, FindsAKnownError) {
  testing::scale(model_, 1.1f);
  const auto report = run(model_);
  ASSERT_TRUE(report);
  EXPECT_NEAR(report->all.relative, 0.1, 1e-3);
  EXPECT_NEAR(report->superposition->sameLamps.relative, 0.1, 1e-3);
  EXPECT_LT(report->all.psnr, 35);
}

TEST_F(Validate, SumsLightsByHullAndRank) {
  // Spoils the lights around one capture: the red of the first.
  for (float& value : model_.V.values.as<float>().first(static_cast<std::size_t>(model_.rank)))
    value *= 3;
  const auto report = run(model_);
  ASSERT_TRUE(report);
  EXPECT_EQ(report->inside.count + report->outside.count, report->all.count);
  double sum = 0, inside = 0;
  for (const auto& light : report->lights) {
    sum += light.error.psnr;
    if (light.insideHull) inside += light.error.psnr;
  }
  EXPECT_NEAR(report->all.psnr, sum / 5, 1e-9);
  ASSERT_GT(report->inside.count, 0);
  EXPECT_NEAR(report->inside.psnr, inside / report->inside.count, 1e-9);
  EXPECT_TRUE(std::ranges::is_sorted(report->worstFirst, {},
                                     [&](std::size_t i) { return report->lights[i].error.psnr; }));
  EXPECT_LT(report->worst().error.psnr, report->best().error.psnr);
  EXPECT_EQ(&report->median(), &report->lights[report->worstFirst[2]]);
}

TEST_F(Validate, TheHullSeparatesTheRimFromTheMiddle) {
  const auto report = run(model_);
  ASSERT_TRUE(report);
  ASSERT_EQ(report->hull.size(), 360u);
  // The captures fill the cap within 60 degrees, some 20 degrees apart; between two at its rim the
  // hull cuts a part off.
  for (const Eigen::Vector3d& corner : report->hull) {
    EXPECT_GT(corner.z(), std::cos(60.0 * std::numbers::pi / 180));
    EXPECT_LT(corner.z(), std::cos(40.0 * std::numbers::pi / 180));
  }
  EXPECT_TRUE(report->lights.front().insideHull);  // frame 4, near +z
}

TEST_F(Validate, TheRelitSumIsTheSumOfTheCaptures) {
  ValidateOptions options;
  options.environment = analyticSky();
  options.environmentName = "given";
  const auto report = run(model_, options);
  ASSERT_TRUE(report);
  const Superposition& sum = report->superposition.value();
  EXPECT_EQ(sum.environment, "given");
  EXPECT_LT(sum.sameLamps.relative, 5e-4);  // half-float captures
  EXPECT_GT(sum.sameLamps.psnr, 55);
  // Here the model's lights are the captures; the mask cuts at whole pixels of the map.
  EXPECT_LT(sum.ownCells.relative, 0.03);
  // The cap within 60 degrees is half the hemisphere; a rim of half a spacing joins it.
  EXPECT_GT(sum.coveredSolidAngle, 0.9 * std::numbers::pi);
  EXPECT_LT(sum.coveredSolidAngle, 1.5 * std::numbers::pi);
  EXPECT_LT(sum.linearity, 4e-6);  // float rounding
}

TEST_F(Validate, DifferencePicturesAreFourTimesTheDifference) {
  testing::scale(model_, 1.1f);
  const auto report = run(model_);
  ASSERT_TRUE(report);
  ASSERT_EQ(report->shown.size(), 5u);
  const PictureTriple& triple = report->shown.front().pictures;
  ASSERT_EQ(triple.truth.width(), kWidth);
  ASSERT_EQ(triple.truth.height(), kHeight);
  for (std::size_t i = 0; i < triple.truth.size(); ++i) {
    const int d = std::abs(int{triple.relit.data()[i]} - int{triple.truth.data()[i]});
    EXPECT_EQ(int{triple.difference.data()[i]}, std::min(255, 4 * d));
  }
}

TEST_F(Validate, PicturesOfOneLightAreThoseOfTheReport) {
  testing::scale(model_, 1.1f);
  const auto report = run(model_);
  ASSERT_TRUE(report);
  const auto interpolator = interpolatorFor(model_);
  ASSERT_TRUE(interpolator);
  for (const ShownLight& shown : report->shown) {
    const auto one = heldOutPictures(sketch_, model_, *interpolator, report->lights[shown.light].id,
                                     report->pictureExposure);
    ASSERT_TRUE(one) << one.error().message;
    EXPECT_TRUE(std::ranges::equal(one->truth.values(), shown.pictures.truth.values()));
    EXPECT_TRUE(std::ranges::equal(one->relit.values(), shown.pictures.relit.values()));
    EXPECT_TRUE(std::ranges::equal(one->difference.values(), shown.pictures.difference.values()));
  }
  EXPECT_EQ(toJson(*report)["pictureExposure"], report->pictureExposure);
}

TEST_F(Validate, ShowsAsManyLightsAsAsked) {
  ValidateOptions options;
  options.pictures = 3;
  const auto report = run(model_, options);
  ASSERT_TRUE(report);
  ASSERT_EQ(report->shown.size(), 3u);
  EXPECT_EQ(report->shown[0].light, report->worstFirst[0]);
  EXPECT_EQ(report->shown[1].light, report->worstFirst[2]);
  EXPECT_EQ(report->shown[2].light, report->worstFirst[4]);
}

TEST_F(Validate, SizeIsBytesPerPixelAndPerCapture) {
  const auto file = folder_.path() / "model.lsd";
  std::ofstream(file) << std::string(1234, 'x');
  ValidateOptions options;
  options.modelFile = file;
  const auto report = run(model_, options);
  ASSERT_TRUE(report);
  ASSERT_TRUE(report->size);
  EXPECT_EQ(report->size->bytes, 1234u);
  EXPECT_NEAR(report->size->bitsPerPixel, 8 * 1234.0 / (kWidth * kHeight), 1e-9);
  EXPECT_NEAR(report->size->ratioToHalf, 35 * kWidth * kHeight * 3 * 2 / 1234.0, 1e-9);
  EXPECT_NEAR(report->size->ratioToFloat, 2 * report->size->ratioToHalf, 1e-9);
}

TEST_F(Validate, RefusesAModelThatSawAHeldOutFrame) {
  model_.capturedIds[0] = 12;
  EXPECT_NE(refusal(model_).find("has seen frame 12"), std::string::npos) << refusal(model_);
}

TEST_F(Validate, RefusesAnotherHoldOutRule) {
  ValidateOptions options;
  options.holdOutRule = "every:8:3";
  EXPECT_EQ(refusal(model_, options),
            "validate: the model was made with hold-out 'every:8:4', not 'every:8:3'; compress the "
            "sketch again with --hold-out every:8:3");
  options.holdOutRule = kRule;
  EXPECT_EQ(refusal(model_, options), "accepted");
}

TEST_F(Validate, RefusesWhatCannotBeMeasured) {
  RelightableModel sawAll = model_;
  sawAll.holdOutRule.clear();
  EXPECT_NE(refusal(sawAll).find("has seen every frame"), std::string::npos) << refusal(sawAll);

  RelightableModel other = model_;
  other.layout.width += 1;
  EXPECT_NE(refusal(other).find("23 x 14 pixels, the sketch 22 x 14"), std::string::npos);

  RelightableModel unknown = model_;
  unknown.capturedIds.clear();
  EXPECT_NE(refusal(unknown).find("which frames it was made from"), std::string::npos);

  ValidateOptions options;
  options.modelFile = folder_.path() / "absent.lsd";
  EXPECT_NE(refusal(model_, options).find("absent.lsd"), std::string::npos);
}

TEST_F(Validate, StopsWhenCancelled) {
  class Cancelled final : public Progress {
    void update(std::string_view, std::size_t, std::size_t) override {}
    void warn(std::string_view) override {}
    bool cancelled() const override { return true; }
  } progress;
  const auto report = validate(sketch_, model_, {}, progress);
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().code, ErrorCode::kCancelled);
}

TEST_F(Validate, DescribesItselfInAFewAlignedLines) {
  const auto report = run(model_);
  ASSERT_TRUE(report);
  const std::string text = report->describe();
  for (const char* part :
       {"mean", "inside the hull", "outside the hull", "worst", "median", "best"}) {
    EXPECT_NE(text.find(part), std::string::npos) << part;
  }
  EXPECT_LT(std::ranges::count(text, '\n'), 12);
}

TEST(AnalyticSky, FollowsTheEnvironmentConvention) {
  const RadianceImage sky = analyticSky();
  const auto brightness = [&](const Eigen::Vector3d& d) {
    return environmentRadiance(sky, d.normalized()).sum();
  };
  // The bright patch is at the upper right in front; the mirrored places are dim.
  EXPECT_GT(brightness({0.5, 0.6, 0.62}), 5 * brightness({-0.5, 0.6, 0.62}));
  EXPECT_GT(brightness({0.5, 0.6, 0.62}), 5 * brightness({0.5, -0.6, 0.62}));
  EXPECT_GT(brightness({0.5, 0.6, 0.62}), 5 * brightness({0.5, 0.6, -0.62}));
  // Blue above, warm below.
  const Eigen::Vector3f up = environmentRadiance(sky, Eigen::Vector3d::UnitY());
  const Eigen::Vector3f down = environmentRadiance(sky, -Eigen::Vector3d::UnitY());
  EXPECT_GT(up.z(), up.x());
  EXPECT_LT(down.z(), down.x());
}

}  // namespace
}  // namespace lightsketch
