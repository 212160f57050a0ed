// Bad frames out and back in, as a script does it.
#include <Eigen/Core>
#include <cmath>
#include <numbers>

#include "capture/frame/json.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch.h"
#include "tests/ui/cli/program_test.h"

namespace lightsketch {
namespace {

constexpr int kFrames = 96;
constexpr int kJump = 20;    // 1.5 times as bright
constexpr int kShadow = 50;  // a third of it dark

class CullCommand : public ProgramTest {
 protected:
  void SetUp() override {
    ProgramTest::SetUp();
    SketchManifest manifest;
    manifest.width = 40;
    manifest.height = 30;
    auto sketch = Sketch::create(path("sketch"), manifest);
    ASSERT_TRUE(sketch);
    for (int i = 0; i < kFrames; ++i) {
      const double z = 1 - 0.7 * (i + 0.5) / kFrames;
      const double turn = i * std::numbers::pi * (3 - std::sqrt(5.0));
      FrameRecord record;
      record.light.direction = {std::sqrt(1 - z * z) * std::cos(turn),
                                std::sqrt(1 - z * z) * std::sin(turn), z};
      RadianceImage image(40, 30, 3);
      for (int y = 0; y < 30; ++y) {
        for (int x = 0; x < 40; ++x) {
          const Eigen::Vector3d normal =
              Eigen::Vector3d(0.4 * std::sin(0.3 * x), 0.4 * std::cos(0.25 * y), 1).normalized();
          double value = 0.6 * std::max(0.0, normal.dot(record.light.direction));
          if (i == kJump) value *= 1.5;
          if (i == kShadow && x > 10 && x < 24) value *= 0.2;
          for (int c = 0; c < 3; ++c) image(x, y, c) = static_cast<float>(value);
        }
      }
      ASSERT_TRUE(sketch->appendUnsynced(record, image));
    }
    ASSERT_TRUE(sketch->sync());
  }
  FrameRecord frame(int id) const {
    const auto sketch = Sketch::open(path("sketch"));
    EXPECT_TRUE(sketch) << sketch.error().message;
    return sketch->frames()[static_cast<std::size_t>(id)];
  }
};

TEST_F(CullCommand, ReportsAppliesAndUndoes) {
  const std::string journal = slurp(path("sketch") / "frames.jsonl");
  const auto looked = run({"cull", path("sketch"), "--report", path("look"), "--quiet"});
  ASSERT_EQ(looked.exitCode, 0) << looked.error;
  EXPECT_NE(looked.out.find("Nothing was changed"), std::string::npos) << looked.out;
  EXPECT_EQ(slurp(path("sketch") / "frames.jsonl"), journal);
  EXPECT_NE(slurp(path("look") / "index.html").find("frame-50"), std::string::npos);

  const auto applied =
      run({"cull", path("sketch"), "--report", path("cull"), "--apply", "--json", path("c.json")});
  ASSERT_EQ(applied.exitCode, 0) << applied.error;
  EXPECT_NE(applied.out.find("--undo"), std::string::npos) << applied.out;
  EXPECT_TRUE(frame(kShadow).dropped);
  EXPECT_NE(frame(kShadow).dropReason.find("shadow"), std::string::npos);
  EXPECT_FALSE(frame(kJump).dropped);
  EXPECT_NEAR(frame(kJump).lampScale[1], 1.5, 0.06);  // neighbours predict to a percent or two
  const auto figures = readJsonFile(path("c.json"));
  ASSERT_TRUE(figures);
  EXPECT_GE((*figures)["dropped"], 1);
  EXPECT_GE((*figures)["correctedBrightness"], 1);

  const auto undone = run({"cull", path("sketch"), "--undo", path("cull") / "cull.json"});
  ASSERT_EQ(undone.exitCode, 0) << undone.error;
  for (int id = 0; id < kFrames; ++id) {
    const FrameRecord now = frame(id);
    EXPECT_FALSE(now.dropped) << id;
    EXPECT_DOUBLE_EQ(now.lampScale[1], 1) << id;
  }
}

TEST_F(CullCommand, RefusesWhatCouldNotBeUndone) {
  EXPECT_EQ(run({"cull", path("sketch"), "--apply"}).exitCode, 2);
  // A report that changed nothing undoes nothing.
  ASSERT_EQ(run({"cull", path("sketch"), "--report", path("look"), "--quiet"}).exitCode, 0);
  expectRefusal({"cull", path("sketch"), "--undo", path("look") / "cull.json"}, "cull --apply");
  std::ofstream(path("torn.json")) << R"({"sketch": 3)";
  expectRefusal({"cull", path("sketch"), "--undo", path("torn.json")}, "torn.json");
}

TEST_F(CullCommand, KeepsTheOnlyWayBack) {
  ASSERT_EQ(run({"cull", path("sketch"), "--report", path("cull"), "--apply"}).exitCode, 0);
  const std::string record = slurp(path("cull") / "cull.json");
  const std::string journal = slurp(path("sketch") / "frames.jsonl");
  expectRefusal({"cull", path("sketch"), "--report", path("cull"), "--quiet"}, "--undo");
  expectRefusal({"cull", path("sketch"), "--report", path("cull"), "--apply", "--quiet"}, "--undo");
  EXPECT_EQ(slurp(path("cull") / "cull.json"), record);
  EXPECT_EQ(slurp(path("sketch") / "frames.jsonl"), journal);
  // Undone once, the folder is free, and there is nothing left to undo.
  const fs::path file = path("cull") / "cull.json";
  ASSERT_EQ(run({"cull", path("sketch"), "--undo", file}).exitCode, 0);
  expectRefusal({"cull", path("sketch"), "--undo", file}, "nothing to undo");
  const auto again = run({"cull", path("sketch"), "--report", path("cull"), "--quiet"});
  EXPECT_EQ(again.exitCode, 0) << again.error;
}

TEST_F(CullCommand, UndoesWhereverTheSketchNowLies) {
  const LightDirection light = frame(kJump).light;
  ASSERT_EQ(run({"cull", path("sketch"), "--report", path("cull"), "--apply"}).exitCode, 0);
  fs::rename(path("sketch"), path("moved"));
  const auto undone = run({"cull", path("moved"), "--undo", path("cull") / "cull.json"});
  ASSERT_EQ(undone.exitCode, 0) << undone.error;
  fs::rename(path("moved"), path("sketch"));
  EXPECT_FALSE(frame(kShadow).dropped);
  EXPECT_DOUBLE_EQ(frame(kJump).lampScale[1], 1);
  EXPECT_EQ(frame(kJump).light.direction, light.direction);
}

TEST_F(CullCommand, UndoesOnlyItsOwnSketchAndItsOwnChanges) {
  const fs::path file = path("cull") / "cull.json";
  ASSERT_EQ(run({"cull", path("sketch"), "--report", path("cull"), "--apply"}).exitCode, 0);
  {
    SketchManifest manifest;
    manifest.width = 40;
    manifest.height = 30;
    ASSERT_TRUE(Sketch::create(path("other"), manifest));
  }
  expectRefusal({"cull", path("other"), "--undo", file}, "not what `cull --apply` wrote about");
  // Somebody else corrected the light since.
  {
    auto sketch = Sketch::openForAppend(path("sketch"));
    ASSERT_TRUE(sketch) << sketch.error().message;
    LightDirection light;
    light.direction = Eigen::Vector3d::UnitZ();
    ASSERT_TRUE(sketch->relight(kJump, light, "by hand"));
  }
  const std::string journal = slurp(path("sketch") / "frames.jsonl");
  expectRefusal({"cull", path("sketch"), "--undo", file}, "frame 20 ");
  EXPECT_EQ(slurp(path("sketch") / "frames.jsonl"), journal);
}

TEST_F(CullCommand, DropsAndRestoresByHand) {
  const auto dropped = run({"drop", path("sketch"), "3", "7", "--reason", "my sleeve"});
  ASSERT_EQ(dropped.exitCode, 0) << dropped.error;
  EXPECT_TRUE(frame(3).dropped);
  EXPECT_EQ(frame(7).dropReason, "my sleeve");
  EXPECT_FALSE(frame(4).dropped);
  ASSERT_EQ(run({"restore", path("sketch"), "7"}).exitCode, 0);
  EXPECT_FALSE(frame(7).dropped);
  EXPECT_TRUE(frame(3).dropped);
  expectRefusal({"drop", path("sketch"), "5", "4711", "--reason", "x"}, "no frame 4711");
  EXPECT_FALSE(frame(5).dropped);
  EXPECT_EQ(run({"drop", path("sketch"), "5"}).exitCode, 2);
}

}  // namespace
}  // namespace lightsketch
