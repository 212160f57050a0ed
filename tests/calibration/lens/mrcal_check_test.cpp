#include "calibration/lens/mrcal_check.h"

#include <gtest/gtest.h>

#include "calibration/lens/camera_formats.h"
#include "tests/calibration/lens/synthetic_lens.h"
#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

LensCalibration solved() {
  const TrueLens lens;
  const BoardGeometry board = largeBoard();
  SceneOptions scene;
  scene.views = 25;
  LensCalibrationOptions options;
  options.splits = 0;
  options.family = LensFamily::kFisheye624;
  SilentProgress progress;
  auto result = calibrateLens(syntheticViews(lens, board, scene), board, lens.width, lens.height,
                              options, progress);
  EXPECT_TRUE(result) << result.error().message;
  return *result;
}

// Solved once for all tests.
const LensCalibration& calibrated() {
  static const LensCalibration calibration = solved();
  return calibration;
}

TEST(MrcalCheck, TwoLensesFromTheSameCornersAgree) {
  const auto& calibration = calibrated();
  const auto check = checkWithMrcal(calibration, largeBoard());
  ASSERT_TRUE(check) << check.error().message;
  // 0.2 pixels of noise; 25 views leave mrcal's 16 x 16 knots some 0.05 degrees, ours far less.
  EXPECT_LT(check->rms.degrees(), 0.06);
  EXPECT_GT(check->rms.degrees(), 0.001);  // two different lenses
  EXPECT_NEAR(check->residualPixels, 0.2, 0.01);
  ASSERT_GE(check->byFieldAngle.size(), 17u);
  EXPECT_LT(check->byFieldAngle[4].degrees(), 0.03);
}

TEST(MrcalCheck, ALensThatIsWrongIsSeen) {
  auto calibration = calibrated();
  // A mistake of half a degree at 80 degrees off axis, which the corners do not support.
  auto wrong = calibration.model->values();
  wrong.k[1] += 0.0016;
  calibration.model = *FisheyeModel::create(wrong, calibration.model->uncertainty());
  const auto check = checkWithMrcal(calibration, largeBoard());
  ASSERT_TRUE(check) << check.error().message;
  EXPECT_GT(check->largest.degrees(), 0.3);
  EXPECT_LT(check->largest.degrees(), 1.5);
}

TEST(MrcalCheck, MrcalsLensIsReadBackAsTheSameLens) {
  const TemporaryFolder folder;
  const auto& calibration = calibrated();
  const auto check = checkWithMrcal(calibration, largeBoard());
  ASSERT_TRUE(check) << check.error().message;
  writeContent(folder / "lens.cameramodel", check->cameraModel);
  const auto loaded = loadAnyCameraModel(folder / "lens.cameramodel");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_LT(loaded->conversion.largestError.degrees(), 0.1);
  // Against the truth, turned as best fits: two independent solves left 0.06 degrees above.
  const auto errors = directionErrors(TrueLens{}, *loaded->model, 80);
  EXPECT_LT(errors.rms(0, 80) / kDegree, 0.1);
}

TEST(MrcalCheck, TooFewViewsAreRefused) {
  auto calibration = calibrated();
  calibration.views.resize(2);
  const auto check = checkWithMrcal(calibration, largeBoard());
  ASSERT_FALSE(check);
  EXPECT_NE(check.error().message.find("2 views"), std::string::npos);
  MrcalCheckOptions options;
  options.knots = 2;
  EXPECT_FALSE(checkWithMrcal(calibration, largeBoard(), options));
}

}  // namespace
}  // namespace lightsketch
