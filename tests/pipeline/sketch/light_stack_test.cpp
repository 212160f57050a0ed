#include "pipeline/sketch/light_stack.h"

#include <gtest/gtest.h>

#include "tests/capture/frame/temporary_folder.h"
#include "tests/pipeline/sketch/samples.h"

namespace lightsketch {
namespace {

TEST(LightStack, SubtractsAmbientAndDividesByTheLampScale) {
  const TemporaryFolder folder;
  auto sketch = Sketch::create(folder / "s", sampleManifest(4, 3)).value();
  FrameRecord record = sampleRecord(0);
  record.lampScale = {0.5, 1, 4};
  ASSERT_TRUE(sketch.append(sampleRecord(0), RadianceImage(4, 3, 3, 0.5f)));
  ASSERT_TRUE(sketch.append(record, RadianceImage(4, 3, 3, 0.75f)));
  ASSERT_TRUE(sketch.writeAmbient(RadianceImage(4, 3, 3, 0.25f)));
  const auto stack = LightStack::create(sketch, {1, 0}).value();
  EXPECT_EQ(stack.size(), 2);
  EXPECT_EQ(stack.width(), 4);
  EXPECT_EQ(stack.height(), 3);
  EXPECT_EQ(stack.directions()[0], sketch.frames()[1].light.direction);
  const auto image = stack.read(0).value();
  EXPECT_FLOAT_EQ(image(3, 2, 0), 1.0f);
  EXPECT_FLOAT_EQ(image(3, 2, 1), 0.5f);
  EXPECT_FLOAT_EQ(image(3, 2, 2), 0.125f);
  EXPECT_FLOAT_EQ(stack.read(1).value()(0, 0, 0), 0.25f);
}

TEST(LightStack, LeavesFramesAloneThatHaveNoAmbientLight) {
  const TemporaryFolder folder;
  SketchManifest manifest = sampleManifest(4, 3);
  manifest.ambientSubtracted = true;
  auto sketch = Sketch::create(folder / "s", manifest).value();
  ASSERT_TRUE(sketch.append(sampleRecord(0), RadianceImage(4, 3, 3, 0.5f)));
  ASSERT_TRUE(sketch.writeAmbient(RadianceImage(4, 3, 3, 0.25f)));
  EXPECT_EQ(LightStack::create(sketch, {0}).value().read(0).value()(0, 0, 0), 0.5f);
}

TEST(LightStack, RefusesDroppedAndUnknownFrames) {
  const TemporaryFolder folder;
  auto sketch = Sketch::create(folder / "s", sampleManifest(4, 3)).value();
  ASSERT_TRUE(sketch.append(sampleRecord(0), sampleImage(4, 3, 0)));
  ASSERT_TRUE(sketch.drop(0, "shadow"));
  const auto dropped = LightStack::create(sketch, {0});
  ASSERT_FALSE(dropped);
  EXPECT_NE(dropped.error().message.find("shadow"), std::string::npos);
  EXPECT_FALSE(LightStack::create(sketch, {1}));
  EXPECT_FALSE(LightStack::create(sketch, {-1}));
}

}  // namespace
}  // namespace lightsketch
