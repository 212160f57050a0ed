#include "pipeline/sketch/sketch.h"

#include <gtest/gtest.h>

#include <fstream>
#include <functional>

#include "capture/frame/file.h"
#include "pipeline/sketch/image_file.h"
#include "tests/capture/frame/temporary_folder.h"
#include "tests/pipeline/sketch/samples.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

// A journal line as the format says it: the object's text, closed by its own checksum.
std::string sealed(const Json& event) {
  std::string text = event.dump();
  text.pop_back();
  return text + ",\"crc\":\"" + checksum(text) + "\"}\n";
}

// The event of a line, without its checksum.
Json eventIn(const std::string& line) {
  Json event = Json::parse(line);
  event.erase("crc");
  return event;
}

std::vector<std::string> linesIn(const fs::path& path) {
  std::vector<std::string> lines;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) lines.push_back(line + "\n");
  return lines;
}

constexpr int kWidth = 12;
constexpr int kHeight = 8;

class SketchOnDisk : public testing::Test {
 protected:
  fs::path folder() const { return temporary_ / "s"; }
  fs::path journal() const { return folder() / "frames.jsonl"; }

  void createWithFrames(int count) {
    auto sketch = Sketch::create(folder(), sampleManifest(kWidth, kHeight));
    ASSERT_TRUE(sketch) << sketch.error().message;
    for (int i = 0; i < count; ++i) {
      const auto id = sketch->append(sampleRecord(i), sampleImage(kWidth, kHeight, i));
      ASSERT_TRUE(id) << id.error().message;
      ASSERT_EQ(*id, i);
    }
  }

  void expectFrames(const Sketch& sketch, int count) {
    ASSERT_EQ(static_cast<int>(sketch.frames().size()), count);
    for (int i = 0; i < count; ++i) {
      const auto image = sketch.readFrame(i);
      ASSERT_TRUE(image) << image.error().message;
      EXPECT_TRUE(sameValues(*image, sampleImage(kWidth, kHeight, i))) << i;
    }
  }

  // Opening must fail with one line that speaks of `what`.
  void expectRefused(const std::string& what, ErrorCode code = ErrorCode::kCorrupt) {
    for (const auto& open : {Sketch::open, Sketch::openForAppend}) {
      const auto sketch = open(folder());
      ASSERT_FALSE(sketch) << what;
      EXPECT_EQ(sketch.error().code, code) << sketch.error().message;
      EXPECT_NE(sketch.error().message.find(what), std::string::npos) << sketch.error().message;
      EXPECT_NE(sketch.error().message.find(folder().string()), std::string::npos)
          << sketch.error().message;
      EXPECT_EQ(sketch.error().message.find('\n'), std::string::npos);
    }
  }

  TemporaryFolder temporary_;
};

TEST_F(SketchOnDisk, KeepsEverythingARecordSays) {
  SketchManifest manifest = sampleManifest(kWidth, kHeight);
  manifest.fullSphere = true;
  manifest.ambientSubtracted = true;
  manifest.provenance = {{"why", "test"}};
  RigGeometry rig;
  rig.sceneCamera.camera = "scene";
  rig.sourceCameras.push_back({"source", Eigen::Isometry3d::Identity()});

  FrameRecord record = sampleRecord(1);
  record.origin = "b\xC3\xA4r 1.jpg";
  record.light.direction = Eigen::Vector3d(1, 2, -3).normalized();
  record.light.covariance = Eigen::Vector3d(1e-6, 2e-6, 1.0 / 3).asDiagonal();
  record.light.position = Eigen::Vector3d(0.1, 0.2, -0.3);
  record.lampPixels.push_back({"source", {100.25, 200.5}, Eigen::Matrix2d::Identity() * 0.01});
  record.calibrationId = "abc";
  record.exposureSeconds = 0.0213;
  record.gainDb = 3.5;
  record.lampScale = {1.1, 0.9, 1.0 / 3};
  record.midExposureSeconds = 12.125;
  record.pairingErrorSeconds = 0.004;
  record.saturatedFraction = 0.001;
  record.gates = {{"motionDegrees", 0.25}};
  {
    auto sketch = Sketch::create(folder(), manifest, rig).value();
    ASSERT_TRUE(sketch.append(record, sampleImage(kWidth, kHeight, 0)));
  }
  const auto sketch = Sketch::open(folder()).value();
  EXPECT_EQ(sketch.manifest().width, kWidth);
  EXPECT_EQ(sketch.manifest().height, kHeight);
  EXPECT_EQ(sketch.manifest().directions, 300);
  EXPECT_TRUE(sketch.manifest().fullSphere);
  EXPECT_TRUE(sketch.manifest().ambientSubtracted);
  EXPECT_EQ(sketch.manifest().software, "test 1");
  EXPECT_EQ(sketch.manifest().cameras, manifest.cameras);
  EXPECT_EQ(sketch.manifest().provenance, manifest.provenance);
  ASSERT_TRUE(sketch.rig());
  EXPECT_EQ(sketch.rig()->sceneCamera.camera, "scene");

  const FrameRecord& read = sketch.frames().at(0);
  EXPECT_EQ(read.id, 0);
  EXPECT_EQ(read.file, "frames/000000.exr");
  EXPECT_EQ(read.checksum, checksumOfFile(folder() / read.file).value());
  EXPECT_EQ(read.origin, record.origin);
  EXPECT_EQ(read.light.direction, record.light.direction);
  EXPECT_EQ(read.light.covariance, record.light.covariance);
  EXPECT_EQ(read.light.position, record.light.position);
  ASSERT_EQ(read.lampPixels.size(), 1u);
  EXPECT_EQ(read.lampPixels[0].camera, "source");
  EXPECT_EQ(read.lampPixels[0].pixel, record.lampPixels[0].pixel);
  EXPECT_EQ(read.lampPixels[0].covariance, record.lampPixels[0].covariance);
  EXPECT_EQ(read.calibrationId, "abc");
  EXPECT_EQ(read.exposureSeconds, 0.0213);
  EXPECT_EQ(read.gainDb, 3.5);
  EXPECT_EQ(read.lampScale, record.lampScale);
  EXPECT_EQ(read.midExposureSeconds, 12.125);
  EXPECT_EQ(read.pairingErrorSeconds, 0.004);
  EXPECT_EQ(read.saturatedFraction, 0.001);
  EXPECT_EQ(read.gates, record.gates);
  EXPECT_FALSE(read.dropped);
}

TEST_F(SketchOnDisk, IsReadableWithoutOurCode) {
  createWithFrames(2);
  const Json manifest = Json::parse(contentOf(folder() / "sketch.json"));
  EXPECT_EQ(manifest["format"], "lightsketch-sketch");
  EXPECT_EQ(manifest["formatVersion"], 1);
  EXPECT_EQ(manifest["views"][0]["projection"], "perspective");
  const auto lines = linesIn(journal());
  ASSERT_EQ(lines.size(), 2u);
  const Json event = Json::parse(lines[1]);
  EXPECT_EQ(event["event"], "frame");
  EXPECT_EQ(event["version"], 1);
  EXPECT_EQ(event["light"]["type"], "directional");
  EXPECT_EQ(sealed(eventIn(lines[1])), lines[1]);
}

TEST_F(SketchOnDisk, EditsAreEventsAndNothingIsRewritten) {
  createWithFrames(3);
  const std::string before = contentOf(journal());
  {
    auto sketch = Sketch::openForAppend(folder()).value();
    ASSERT_TRUE(sketch.drop(1, "operator's shadow"));
    ASSERT_TRUE(sketch.drop(1, "again"));  // is dropped already: says nothing
    ASSERT_TRUE(sketch.drop(2, "blurred"));
    ASSERT_TRUE(sketch.restore(2));
    LightDirection light;
    light.direction = Eigen::Vector3d::UnitX();
    ASSERT_TRUE(sketch.relight(0, light, "new-lens"));
    ASSERT_TRUE(sketch.note("tea break"));
    EXPECT_EQ(sketch.activeFrames(), (std::vector<int>{0, 2}));
    EXPECT_FALSE(sketch.drop(3, "x"));
    EXPECT_FALSE(sketch.restore(-1));
    light.direction *= 2;
    EXPECT_FALSE(sketch.relight(0, light, ""));
  }
  const auto sketch = Sketch::open(folder()).value();
  EXPECT_EQ(contentOf(journal()).rfind(before, 0), 0u);
  EXPECT_EQ(linesIn(journal()).size(), 3u + 5u);
  EXPECT_EQ(sketch.activeFrames(), (std::vector<int>{0, 2}));
  EXPECT_EQ(sketch.frames()[1].dropReason, "operator's shadow");
  EXPECT_EQ(sketch.frames()[2].dropReason, "");
  EXPECT_EQ(sketch.frames()[0].light.direction, Eigen::Vector3d::UnitX());
  EXPECT_EQ(sketch.frames()[0].calibrationId, "new-lens");
}

TEST_F(SketchOnDisk, RelightKeepsThePositionAndReplacesTheLampScaleOnlyIfAsked) {
  createWithFrames(2);
  LightDirection light;
  light.direction = Eigen::Vector3d::UnitY();
  light.position = Eigen::Vector3d(0, 0.75, 0);
  light.positionCovariance = Eigen::Vector3d(1e-6, 2e-6, 1.0 / 3).asDiagonal();
  {
    auto sketch = Sketch::openForAppend(folder()).value();
    ASSERT_TRUE(sketch.relight(0, light, "lens", std::array<double, 3>{1.5, 0.5, 1.0 / 3}));
    ASSERT_TRUE(sketch.relight(0, light, "better lens"));
    EXPECT_FALSE(sketch.relight(1, light, "lens", std::array<double, 3>{1, 0, 1}));
  }
  const auto sketch = Sketch::open(folder()).value();
  EXPECT_EQ(sketch.frames()[0].lampScale, (std::array<double, 3>{1.5, 0.5, 1.0 / 3}));
  EXPECT_EQ(sketch.frames()[0].calibrationId, "better lens");
  EXPECT_EQ(sketch.frames()[0].light.position, light.position);
  EXPECT_EQ(sketch.frames()[0].light.positionCovariance, light.positionCovariance);
  EXPECT_EQ(sketch.frames()[1].lampScale, (std::array<double, 3>{1, 1, 1}));
  EXPECT_FALSE(sketch.frames()[1].light.position);
}

TEST_F(SketchOnDisk, GoesOnWhereItStopped) {
  createWithFrames(2);
  {
    auto sketch = Sketch::openForAppend(folder()).value();
    EXPECT_EQ(sketch.append(sampleRecord(2), sampleImage(kWidth, kHeight, 2)).value(), 2);
  }
  expectFrames(Sketch::open(folder()).value(), 3);
}

TEST_F(SketchOnDisk, BulkAppendIsTheSameOnceSynced) {
  {
    auto sketch = Sketch::create(folder(), sampleManifest(kWidth, kHeight)).value();
    for (int i = 0; i < 4; ++i) {
      ASSERT_TRUE(sketch.appendUnsynced(sampleRecord(i), sampleImage(kWidth, kHeight, i)));
    }
    ASSERT_TRUE(sketch.sync());
  }
  expectFrames(Sketch::open(folder()).value(), 4);
}

TEST_F(SketchOnDisk, OneWriterAtATimeAndReadersAlways) {
  createWithFrames(1);
  auto writer = Sketch::openForAppend(folder());
  ASSERT_TRUE(writer);
  const auto second = Sketch::openForAppend(folder());
  ASSERT_FALSE(second);
  EXPECT_NE(second.error().message.find("another program"), std::string::npos);
  EXPECT_TRUE(Sketch::open(folder()));
  writer = Sketch::open(folder());  // gives the lock back
  EXPECT_TRUE(Sketch::openForAppend(folder()));
  const auto refused = writer->append(sampleRecord(1), sampleImage(kWidth, kHeight, 1));
  EXPECT_FALSE(refused);
  EXPECT_FALSE(writer->note("x"));
  EXPECT_FALSE(writer->sync());
}

TEST_F(SketchOnDisk, CreateRefusesAFolderWithContent) {
  createWithFrames(1);
  EXPECT_FALSE(Sketch::create(folder(), sampleManifest(kWidth, kHeight)));
  expectFrames(Sketch::open(folder()).value(), 1);
  EXPECT_FALSE(Sketch::create(temporary_ / "t", sampleManifest(0, 5)));
  EXPECT_FALSE(Sketch::create(temporary_ / "t", sampleManifest(1 << 20, 5)));
  EXPECT_FALSE(fs::exists(temporary_ / "t"));
}

TEST_F(SketchOnDisk, AppendRefusesNonsenseAndStaysUsable) {
  createWithFrames(0);
  auto sketch = Sketch::openForAppend(folder()).value();
  const RadianceImage good = sampleImage(kWidth, kHeight, 0);
  const auto refused = [&](const std::function<void(FrameRecord&)>& change) {
    FrameRecord record = sampleRecord(0);
    change(record);
    const auto id = sketch.append(record, good);
    return !id && id.error().code == ErrorCode::kInvalidArgument;
  };
  EXPECT_TRUE(refused([](auto& r) { r.light.direction.setZero(); }));
  EXPECT_TRUE(refused([](auto& r) { r.light.direction *= 1.01; }));
  EXPECT_TRUE(refused([](auto& r) { r.light.direction.x() = std::nan(""); }));
  EXPECT_TRUE(refused([](auto& r) { r.lampScale[1] = 0; }));
  EXPECT_TRUE(refused([](auto& r) { r.exposureSeconds = std::nan(""); }));
  EXPECT_FALSE(sketch.append(sampleRecord(0), sampleImage(kWidth + 1, kHeight, 0)));
  RadianceImage broken = good;
  broken.data()[7] = std::nanf("");
  EXPECT_FALSE(sketch.append(sampleRecord(0), broken));
  EXPECT_EQ(sketch.append(sampleRecord(0), good).value(), 0);
  expectFrames(Sketch::open(folder()).value(), 1);
}

TEST_F(SketchOnDisk, AmbientIsVerifiedAndReplaceable) {
  createWithFrames(0);
  auto sketch = Sketch::openForAppend(folder()).value();
  EXPECT_FALSE(sketch.readAmbient().value().has_value());
  ASSERT_TRUE(sketch.writeAmbient(sampleImage(kWidth, kHeight, 7)));
  ASSERT_TRUE(sketch.writeAmbient(sampleImage(kWidth, kHeight, 8)));
  const auto reader = Sketch::open(folder()).value();
  EXPECT_TRUE(sameValues(*reader.readAmbient().value(), sampleImage(kWidth, kHeight, 8)));
  EXPECT_FALSE(sketch.writeAmbient(sampleImage(kWidth, kHeight + 1, 8)));

  std::string bytes = contentOf(folder() / "ambient.exr");
  bytes[bytes.size() - 5] ^= 1;
  writeContent(folder() / "ambient.exr", bytes);
  EXPECT_EQ(reader.readAmbient().error().code, ErrorCode::kCorrupt);
}

// --- Damage
// ----------------------------------------------------------------------------------------

TEST_F(SketchOnDisk, LastLineTornAtEveryByteIsIgnoredThenCutOff) {
  createWithFrames(3);
  const std::string whole = contentOf(journal());
  const std::string last = linesIn(journal())[2];
  const std::size_t start = whole.size() - last.size();
  for (std::size_t size = start; size < whole.size(); ++size) {
    writeContent(journal(), whole.substr(0, size));
    const auto reader = Sketch::open(folder());
    ASSERT_TRUE(reader) << size - start << ": " << reader.error().message;
    ASSERT_EQ(reader->frames().size(), 2u) << size - start;
    EXPECT_EQ(contentOf(journal()).size(), size);  // a reader changes nothing

    auto writer = Sketch::openForAppend(folder());
    ASSERT_TRUE(writer) << size - start << ": " << writer.error().message;
    if ((size - start) % 16 != 0) continue;
    // The id was never acknowledged, so it is free, and the orphaned image gives way.
    ASSERT_EQ(writer->append(sampleRecord(2), sampleImage(kWidth, kHeight, 2)).value(), 2);
    expectFrames(Sketch::open(folder()).value(), 3);
  }
}

TEST_F(SketchOnDisk, ALastLineThatAPowerCutLeftInPiecesIsCutOffAndNoted) {
  createWithFrames(2);
  const std::string whole = contentOf(journal());
  for (const std::string& tail : {std::string(300, '\0'), std::string(300, '\0') + "\n",
                                  std::string(300, '\0') + linesIn(journal())[0].substr(300)}) {
    writeContent(journal(), whole + tail);
    ASSERT_EQ(Sketch::open(folder()).value().frames().size(), 2u);
    ASSERT_TRUE(Sketch::openForAppend(folder()));
    const auto lines = linesIn(journal());
    ASSERT_EQ(lines.size(), 3u);
    EXPECT_EQ(eventIn(lines[2])["event"], "note");
  }
}

TEST_F(SketchOnDisk, AFlippedBitAnywhereButInTheLastNewlineIsFound) {
  createWithFrames(3);
  const std::string whole = contentOf(journal());
  const auto lines = linesIn(journal());
  for (std::size_t i = 0; i + 1 < whole.size(); ++i) {
    std::string damaged = whole;
    damaged[i] = static_cast<char>(damaged[i] ^ (1 << (i % 5)));  // never makes a zero byte
    writeContent(journal(), damaged);
    const auto sketch = Sketch::open(folder());
    ASSERT_FALSE(sketch) << i;
    const int number = i < lines[0].size() ? 1 : i < lines[0].size() + lines[1].size() ? 2 : 3;
    const auto line = "frames.jsonl: line " + std::to_string(number) + ":";
    ASSERT_NE(sketch.error().message.find(line), std::string::npos) << sketch.error().message;
  }
  EXPECT_FALSE(Sketch::openForAppend(folder()));
}

TEST_F(SketchOnDisk, AMissingOrDoubledLineIsFound) {
  createWithFrames(3);
  const auto lines = linesIn(journal());
  writeContent(journal(), lines[0] + lines[2]);
  expectRefused("line 2: field 'id' is 2, expected 1");
  writeContent(journal(), lines[0] + lines[0] + lines[1]);
  expectRefused("line 2: field 'id' is 0, expected 1");
}

TEST_F(SketchOnDisk, ARecordCannotPointOutsideTheSketch) {
  createWithFrames(1);
  for (const char* file : {"../secret.exr", "frames/../../secret.exr", "/etc/passwd", "frames/..",
                           "frames/", "frames", "sketch.json", "", "frames/a/b.exr", "./x.exr"}) {
    Json event = eventIn(linesIn(journal())[0]);
    event["file"] = file;
    writeContent(journal(), sealed(event));
    expectRefused("line 1: field 'file'");
  }
}

TEST_F(SketchOnDisk, JournalFieldsAreChecked) {
  createWithFrames(2);
  const auto lines = linesIn(journal());
  const Json good = eventIn(lines[1]);
  for (const auto& [field, value] : good.items()) {
    Json event = good;
    event.erase(field);
    writeContent(journal(), lines[0] + sealed(event));
    expectRefused("line 2: field '" + field + "' is missing");
  }
  Json event = good;
  event["light"]["direction"] = {0, 0, 2};
  writeContent(journal(), lines[0] + sealed(event));
  expectRefused("line 2: the light direction (0, 0, 2) is not a unit vector");
  event = good;
  event["lampScale"] = {1, 0, 1};
  writeContent(journal(), lines[0] + sealed(event));
  expectRefused("line 2: lampScale must be positive");
  event = good;
  event["version"] = 2;
  writeContent(journal(), lines[0] + sealed(event));
  expectRefused("newer lightsketch", ErrorCode::kUnsupported);
  writeContent(journal(), lines[0] + sealed({{"event", "teleport"}, {"version", 1}}));
  expectRefused("'teleport'", ErrorCode::kUnsupported);
  writeContent(journal(),
               lines[0] + sealed({{"event", "drop"}, {"version", 1}, {"id", 1}, {"reason", ""}}));
  expectRefused("line 2: field 'id'");
}

TEST_F(SketchOnDisk, ManifestFieldsAreChecked) {
  createWithFrames(1);
  const fs::path file = folder() / "sketch.json";
  const std::string text = contentOf(file);
  const Json good = Json::parse(text);
  for (const auto& [field, value] : good.items()) {
    Json json = good;
    json.erase(field);
    writeContent(file, json.dump());
    expectRefused("field '" + field + "' is missing");
    json[field] = 1.5;
    writeContent(file, json.dump());
    const auto sketch = Sketch::open(folder());
    EXPECT_FALSE(sketch) << field;
  }
  Json json = good;
  json["views"][0]["width"] = 1'000'000'000;
  writeContent(file, json.dump());
  expectRefused("field 'width'");
  json["views"][0]["width"] = 65536;
  json["views"][0]["height"] = 65536;
  writeContent(file, json.dump());
  expectRefused("65536 x 65536", ErrorCode::kUnsupported);
  json = good;
  json["formatVersion"] = 2;
  writeContent(file, json.dump());
  expectRefused("newer lightsketch", ErrorCode::kUnsupported);
  json = good;
  json["format"] = "lightsketch-camera";
  writeContent(file, json.dump());
  expectRefused("expected a 'lightsketch-sketch'");
  for (std::size_t size = 0; size < text.size() - 2; ++size) {
    writeContent(file, text.substr(0, size));
    ASSERT_FALSE(Sketch::open(folder())) << size;
  }
  writeContent(file, text);
  EXPECT_TRUE(Sketch::open(folder()));
}

TEST_F(SketchOnDisk, MissingPartsAreNamed) {
  expectRefused("no such folder", ErrorCode::kNotFound);
  createWithFrames(1);
  fs::rename(journal(), folder() / "elsewhere");
  expectRefused("frames.jsonl", ErrorCode::kNotFound);
  fs::rename(folder() / "elsewhere", journal());
  fs::remove(folder() / "sketch.json");
  expectRefused("is not a sketch", ErrorCode::kNotFound);
}

TEST_F(SketchOnDisk, DamagedImagesAreNamedAndTheOthersReadable) {
  createWithFrames(3);
  const auto sketch = Sketch::open(folder()).value();
  const fs::path file = folder() / "frames/000001.exr";
  const std::string bytes = contentOf(file);
  const auto expectComplaint = [&](ErrorCode code) {
    const auto image = sketch.readFrame(1);
    ASSERT_FALSE(image);
    EXPECT_EQ(image.error().code, code);
    EXPECT_NE(image.error().message.find("frames/000001.exr"), std::string::npos);
    EXPECT_NE(image.error().message.find("drop frame 1"), std::string::npos);
  };
  writeContent(file, bytes.substr(0, bytes.size() / 2));
  expectComplaint(ErrorCode::kCorrupt);
  std::string damaged = bytes;
  damaged[bytes.size() - 9] ^= 4;
  writeContent(file, damaged);
  expectComplaint(ErrorCode::kCorrupt);
  fs::remove(file);
  expectComplaint(ErrorCode::kNotFound);
  EXPECT_TRUE(sketch.readFrame(0));
  EXPECT_TRUE(sketch.readFrame(2));
  EXPECT_FALSE(sketch.readFrame(3));
  EXPECT_FALSE(sketch.readFrame(-1));
}

TEST_F(SketchOnDisk, AnImageOfAnotherSizeIsRefusedEvenWithTheRightChecksum) {
  createWithFrames(1);
  const auto bytes = encodeExr(sampleImage(kWidth, kHeight + 1, 0)).value();
  writeContent(folder() / "frames/000000.exr", bytes);
  Json event = eventIn(linesIn(journal())[0]);
  event["checksum"] = checksum(bytes);
  writeContent(journal(), sealed(event));
  const auto image = Sketch::open(folder()).value().readFrame(0);
  ASSERT_FALSE(image);
  EXPECT_NE(image.error().message.find("12 x 9"), std::string::npos) << image.error().message;
}

TEST_F(SketchOnDisk, LeftoversOfAKilledWriterAreRemovedByTheNextOneOnly) {
  createWithFrames(1);
  writeContent(folder() / "frames/000001.exr", "orphan");
  writeContent(folder() / "frames/.000002.99-0.partial.exr", "part");
  writeContent(folder() / ".ambient.99-1.partial.exr", "part");
  writeContent(folder() / "frames/remarks.txt", "mine");
  ASSERT_TRUE(Sketch::open(folder()));
  EXPECT_TRUE(fs::exists(folder() / "frames/000001.exr"));
  ASSERT_TRUE(Sketch::openForAppend(folder()));
  EXPECT_FALSE(fs::exists(folder() / "frames/000001.exr"));
  EXPECT_FALSE(fs::exists(folder() / "frames/.000002.99-0.partial.exr"));
  EXPECT_FALSE(fs::exists(folder() / ".ambient.99-1.partial.exr"));
  EXPECT_TRUE(fs::exists(folder() / "frames/remarks.txt"));
  expectFrames(Sketch::open(folder()).value(), 1);
}

}  // namespace
}  // namespace lightsketch
