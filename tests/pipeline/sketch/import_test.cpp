#include "pipeline/sketch/import.h"

#include <gtest/gtest.h>

#include <chrono>
#include <iostream>

#include "pipeline/sketch/light_stack.h"
#include "tests/capture/frame/temporary_folder.h"
#include "tests/pipeline/sketch/samples.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

class ImportSet : public testing::Test {
 protected:
  // `count` frames of known content as 16-bit PNG with dirs.lp in set/.
  void writeSet(int count, int width = 20, int height = 10) {
    fs::create_directories(folder());
    std::string lp = std::to_string(count) + "\n";
    for (int i = 0; i < count; ++i) {
      const std::string name = "im" + std::to_string(i) + ".png";
      ASSERT_TRUE(writePng(folder() / name, toSrgb16(sampleImage(width, height, i))));
      const auto d = sampleDirection(i);
      lp += fmt::format("{} {} {} {}\n", name, d.x(), d.y(), d.z());
    }
    writeContent(folder() / "dirs.lp", lp);
  }
  fs::path folder() const { return temporary_ / "set"; }
  fs::path out() const { return temporary_ / "sketch"; }
  Result<ImportSummary> import(Progress& progress) {
    ImportOptions options;
    options.folder = folder();
    options.out = out();
    options.software = "test 1";
    return importSet(options, progress);
  }
  void expectNothingLeft() {
    EXPECT_FALSE(fs::exists(out()));
    EXPECT_EQ(entriesIn(temporary_.path()), 1);  // set/ alone
  }

  TemporaryFolder temporary_;
  RecordingProgress progress_;
};

TEST_F(ImportSet, KeepsOrderNamesDirectionsAndPixels) {
  writeSet(7);
  const auto summary = import(progress_).value();
  EXPECT_EQ(summary.imported, 7);
  EXPECT_EQ(summary.skipped, 0);
  EXPECT_EQ(summary.width, 20);
  EXPECT_EQ(summary.height, 10);
  EXPECT_EQ(summary.transfer, TransferFunction::kSrgb);
  EXPECT_TRUE(progress_.warnings.empty());
  const auto sketch = Sketch::open(out()).value();
  EXPECT_EQ(sketch.manifest().provenance["transfer"], "sRGB");
  EXPECT_EQ(sketch.manifest().directions, 0);
  ASSERT_EQ(sketch.frames().size(), 7u);
  for (int i = 0; i < 7; ++i) {
    const auto& record = sketch.frames()[static_cast<std::size_t>(i)];
    EXPECT_EQ(record.origin, "im" + std::to_string(i) + ".png");
    EXPECT_LT((record.light.direction - sampleDirection(i)).norm(), 1e-12);
    EXPECT_EQ(record.lampScale, (std::array<double, 3>{1, 1, 1}));
    const auto image = sketch.readFrame(i).value();
    const auto truth = sampleImage(20, 10, i);
    for (std::size_t k = 0; k < image.size(); ++k) {
      // Half keeps 11 bits; 16-bit sRGB is finer than that except near black.
      ASSERT_NEAR(image.values()[k], std::min(truth.values()[k], 1.0f),
                  truth.values()[k] / 2048 + 1e-5f);
    }
  }
}

TEST_F(ImportSet, LinearByOption) {
  writeSet(1);
  ImportOptions options;
  options.folder = folder();
  options.out = out();
  options.transfer = TransferFunction::kLinear;
  ASSERT_TRUE(importSet(options, progress_));
  const auto encoded = toSrgb16(sampleImage(20, 10, 0));
  const auto image = Sketch::open(out())->readFrame(0).value();
  EXPECT_NEAR(image(3, 3, 1), encoded(3, 3, 1) / 65535.0f, 1.0f / 2048);
}

TEST_F(ImportSet, IntensitiesBecomeLampScalesOfMeanOneAndAreDividedOut) {
  writeSet(2);
  writeContent(temporary_ / "set/table.txt", "1 2 3\n2 3 1\n");
  ImportOptions options;
  options.folder = folder();
  options.intensities = folder() / "table.txt";
  options.out = out();
  EXPECT_TRUE(importSet(options, progress_)->intensities);
  const auto sketch = Sketch::open(out()).value();
  EXPECT_EQ(sketch.frames()[0].lampScale, (std::array<double, 3>{0.5, 1, 1.5}));
  EXPECT_EQ(sketch.frames()[1].lampScale, (std::array<double, 3>{1, 1.5, 0.5}));
  EXPECT_EQ(sketch.manifest().provenance["intensityUnit"], 2.0);
  const auto stack = LightStack::create(sketch, {0}).value();
  EXPECT_FLOAT_EQ(stack.read(0).value()(4, 4, 0), 2 * sketch.readFrame(0).value()(4, 4, 0));
}

TEST_F(ImportSet, SaturatedPixelsAreCounted) {
  fs::create_directories(folder());
  RadianceImage image(10, 10, 3, 0.5f);
  image(0, 0, 1) = 1.0f;
  image(1, 0, 0) = image(1, 0, 2) = 1.0f;
  ASSERT_TRUE(writePng(folder() / "a.png", image));
  writeContent(folder() / "dirs.lp", "1\na.png 0 0 1\n");
  ASSERT_TRUE(import(progress_));
  EXPECT_DOUBLE_EQ(Sketch::open(out())->frames()[0].saturatedFraction, 0.02);
}

TEST_F(ImportSet, AnOddSizeIsNamedAndNothingIsLeft) {
  writeSet(5);
  ASSERT_TRUE(writePng(folder() / "im3.png", sampleImage(21, 10, 3)));
  const auto summary = import(progress_);
  ASSERT_FALSE(summary);
  EXPECT_NE(summary.error().message.find("im3.png: is 21 x 10"), std::string::npos)
      << summary.error().message;
  expectNothingLeft();
}

TEST_F(ImportSet, ADamagedImageIsNamedAndNothingIsLeft) {
  writeSet(5);
  const std::string bytes = contentOf(folder() / "im2.png");
  writeContent(folder() / "im2.png", bytes.substr(0, bytes.size() / 2));
  const auto summary = import(progress_);
  ASSERT_FALSE(summary);
  EXPECT_NE(summary.error().message.find("im2.png"), std::string::npos);
  expectNothingLeft();
}

TEST_F(ImportSet, CancellingLeavesNothing) {
  writeSet(6);
  RecordingProgress impatient(3);
  const auto summary = import(impatient);
  ASSERT_FALSE(summary);
  EXPECT_EQ(summary.error().code, ErrorCode::kCancelled);
  expectNothingLeft();
}

TEST_F(ImportSet, RefusesAMissingFolderAnEmptyListAndATakenName) {
  EXPECT_EQ(import(progress_).error().code, ErrorCode::kNotFound);
  writeSet(2);
  writeContent(folder() / "dirs.lp", "0\n");
  EXPECT_FALSE(import(progress_));
  expectNothingLeft();
  writeSet(2);
  ASSERT_TRUE(import(progress_));
  EXPECT_FALSE(import(progress_));
  EXPECT_EQ(Sketch::open(out())->frames().size(), 2u);
}

TEST_F(ImportSet, ExportAndImportGiveTheSameSketch) {
  writeSet(5);
  writeContent(folder() / "table.txt", "1\n2\n3\n4\n5\n");
  ImportOptions options;
  options.folder = folder();
  options.intensities = folder() / "table.txt";
  options.out = out();
  ASSERT_TRUE(importSet(options, progress_));
  auto sketch = Sketch::openForAppend(out()).value();
  ASSERT_TRUE(sketch.drop(1, "blurred"));

  for (const auto format : {ExportLpOptions::Format::kPng16, ExportLpOptions::Format::kPng8,
                            ExportLpOptions::Format::kExr}) {
    const TemporaryFolder other;
    EXPECT_EQ(exportLp(sketch, other / "lp", {format}, progress_).value(), 4);
    ImportOptions again;
    again.folder = other / "lp";
    again.out = other / "sketch";
    ASSERT_EQ(importSet(again, progress_)->imported, 4);
    const auto copy = Sketch::open(other / "sketch").value();
    const auto ids = sketch.activeFrames();
    for (std::size_t i = 0; i < ids.size(); ++i) {
      const auto& before = sketch.frames()[static_cast<std::size_t>(ids[i])];
      EXPECT_LT((copy.frames()[i].light.direction - before.light.direction).norm(), 1e-12);
      // The mean is taken over other frames, so only ratios stay.
      EXPECT_NEAR(copy.frames()[i].lampScale[0] / copy.frames()[0].lampScale[0],
                  before.lampScale[0] / sketch.frames()[0].lampScale[0], 1e-12);
      const auto a = copy.readFrame(static_cast<int>(i)).value();
      const auto b = sketch.readFrame(ids[i]).value();
      if (format == ExportLpOptions::Format::kExr) {
        EXPECT_TRUE(sameValues(a, b));
        continue;
      }
      // A half step is 1/2048 of the value at most. A step of 8-bit sRGB is at most 0.0089 in
      // linear light, of which rounding makes half.
      const bool fine = format == ExportLpOptions::Format::kPng16;
      for (std::size_t k = 0; k < a.size(); ++k) {
        ASSERT_NEAR(a.values()[k], b.values()[k], fine ? b.values()[k] / 2048 + 1e-5f : 0.0050f);
      }
    }
    EXPECT_FALSE(exportLp(sketch, other / "lp", {format}, progress_));  // the name is taken
  }
}

TEST_F(ImportSet, ExportSubtractsAmbientLightAndCanBeCancelled) {
  auto sketch = Sketch::create(out(), sampleManifest(4, 4)).value();
  EXPECT_FALSE(exportLp(sketch, temporary_ / "lp", {}, progress_));  // no frames
  ASSERT_TRUE(sketch.append(sampleRecord(0), RadianceImage(4, 4, 3, 0.75f)));
  ASSERT_TRUE(sketch.writeAmbient(RadianceImage(4, 4, 3, 0.25f)));
  RecordingProgress impatient(0);
  EXPECT_EQ(exportLp(sketch, temporary_ / "lp", {}, impatient).error().code, ErrorCode::kCancelled);
  EXPECT_FALSE(fs::exists(temporary_ / "lp"));
  ASSERT_TRUE(exportLp(sketch, temporary_ / "lp", {ExportLpOptions::Format::kExr}, progress_));
  EXPECT_EQ(readImage(temporary_ / "lp/image000000.exr").value()(2, 2, 2), 0.5f);
  EXPECT_FALSE(fs::exists(temporary_ / "lp/light_intensities.txt"));
}

TEST_F(ImportSet, DescriptionCountsWhatIsThere) {
  writeSet(5);
  ASSERT_TRUE(import(progress_));
  ASSERT_TRUE(Sketch::openForAppend(out())->drop(0, "x"));
  const Json info = describeSketch(out()).value();
  EXPECT_EQ(info["frames"], 4);
  EXPECT_EQ(info["dropped"], 1);
  EXPECT_EQ(info["width"], 20);
  EXPECT_EQ(info["ambient"], "none recorded");
  double lowest = 1;
  for (int i = 1; i < 5; ++i) lowest = std::min(lowest, sampleDirection(i).z());
  EXPECT_NEAR(info["directionMin"][2].get<double>(), lowest, 1e-12);
  std::uintmax_t bytes = 0;
  for (const auto& entry : fs::recursive_directory_iterator(out())) {
    if (entry.is_regular_file()) bytes += entry.file_size();
  }
  EXPECT_EQ(info["bytes"], bytes);
  EXPECT_EQ(describeSketch(folder()).error().code, ErrorCode::kNotFound);
}

// --- Real sets
// -------------------------------------------------------------------------------------

struct RealSet {
  const char* folder;
  int images;
  int width;
  int height;
  TransferFunction transfer;
  bool intensities;
};

std::ostream& operator<<(std::ostream& out, const RealSet& set) { return out << set.folder; }

class RealData : public testing::TestWithParam<RealSet> {};

TEST_P(RealData, IsImported) {
  const RealSet& set = GetParam();
  const fs::path folder = fs::path(LIGHTSKETCH_SOURCE_DIR "/../shared/data/rti") / set.folder;
  if (!fs::exists(folder)) GTEST_SKIP() << folder << " is not there";
  const TemporaryFolder temporary;
  RecordingProgress progress;
  ImportOptions options;
  options.folder = folder;
  options.out = temporary / "sketch";
  const auto start = std::chrono::steady_clock::now();
  const auto summary = importSet(options, progress);
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(summary->imported, set.images);
  EXPECT_EQ(summary->width, set.width);
  EXPECT_EQ(summary->height, set.height);
  EXPECT_EQ(summary->transfer, set.transfer);
  EXPECT_EQ(summary->intensities, set.intensities);
  const auto sketch = Sketch::open(options.out).value();
  ASSERT_EQ(static_cast<int>(sketch.frames().size()), set.images);
  double scale = 0;
  for (const auto& record : sketch.frames()) {
    EXPECT_NEAR(record.light.direction.norm(), 1, 1e-12);
    for (const double factor : record.lampScale) scale += factor / (3 * set.images);
  }
  EXPECT_NEAR(scale, 1, 1e-9);
  const int last = set.images - 1;
  EXPECT_TRUE(sketch.readFrame(last));
  std::cout << set.folder << ": " << summary->describe() << ", " << progress.warnings.size()
            << " warnings, "
            << fmt::format("{:.1f} s, {:.1f} MB\n", seconds.count(),
                           describeSketch(options.out).value()["bytes"].get<double>() / 1e6);
  for (const auto& warning : progress.warnings) std::cout << "  " << warning << "\n";
}

INSTANTIATE_TEST_SUITE_P(
    Sets, RealData,
    testing::Values(RealSet{"realrti_item11", 54, 567, 534, TransferFunction::kSrgb, false},
                    RealSet{"diligent_cat", 96, 612, 512, TransferFunction::kLinear, true},
                    RealSet{"relief_handheld", 895, 124, 110, TransferFunction::kSrgb, false}),
    [](const auto& set) { return std::string(set.param.folder); });

}  // namespace
}  // namespace lightsketch
