// Well-formed HDF5 and EXR files whose contents are whatever the input chooses.
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStdIO.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <OpenEXR/ImfTileDescription.h>
#include <OpenEXR/ImfTiledOutputFile.h>
#include <fmt/format.h>
#include <hdf5.h>
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "capture/frame/json.h"
#include "pipeline/compress/model.h"
#include "pipeline/relight/relighter.h"
#include "pipeline/sketch/image_file.h"
#include "tests/fuzz/choices.h"
#include "tests/fuzz/scratch.h"
#include "tests/fuzz/targets.h"

namespace lightsketch::fuzz {
namespace {

// --- HDF5 ----------------------------------------------------------------------------------------

constexpr hsize_t kUserBlock = 1024;
constexpr int kWidth = 20;
constexpr int kHeight = 12;
constexpr int kBlock = 8;
constexpr hsize_t kBlocks = 6;
constexpr hsize_t kPixels = kBlock * kBlock;
constexpr hsize_t kRows = 12;
constexpr hsize_t kRank = 3;
constexpr hsize_t kLights = 5;

using Shape = std::vector<hsize_t>;

hid_t halfType() {
  const hid_t type = H5Tcopy(H5T_IEEE_F32LE);
  H5Tset_fields(type, 15, 10, 5, 0, 10);
  H5Tset_size(type, 2);
  H5Tset_ebias(type, 15);
  return type;
}

class ModelBuilder {
 public:
  ModelBuilder(Choices& choices, hid_t file) : choices_(choices), file_(file) {}

  // A dataset of `shape` that repeats `value` plus a ramp. Returns its place in the file, 0 if it
  // has none.
  std::uint64_t dataset(const char* name, Shape shape, hid_t type, double value, double ramp,
                        bool packed = false) {
    enum Way { kPlain, kMissing, kGroup, kSoftLink, kExternalLink, kExternalData, kVirtual };
    switch (choices_.pick(kPlain, {kPlain, kPlain, kPlain, kMissing, kGroup, kSoftLink,
                                   kExternalLink, kExternalData, kVirtual})) {
      case kMissing:
        return 0;
      case kGroup:
        H5Gclose(H5Gcreate2(file_, name, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
        return 0;
      case kSoftLink:
        H5Lcreate_soft(choices_.oneOf({"V", "E", "/", "nowhere"}), file_, name, H5P_DEFAULT,
                       H5P_DEFAULT);
        return 0;
      case kExternalLink:
        H5Lcreate_external("/etc/passwd", "E", file_, name, H5P_DEFAULT, H5P_DEFAULT);
        return 0;
      case kExternalData:
        external_ = true;
        break;
      case kVirtual:
        virtual_ = true;
        break;
      case kPlain:
        break;
    }
    for (hsize_t& extent : shape) {
      extent = static_cast<hsize_t>(
          std::max<std::int64_t>(choices_.integer(static_cast<std::int64_t>(extent)), 0));
    }
    if (choices_.hostile()) shape.push_back(1 + choices_.byte() % 3);
    if (choices_.hostile() && shape.size() > 1) shape.pop_back();
    const hid_t other = halfType();
    type = choices_.pick(type, {H5T_STD_I8LE, H5T_STD_U16LE, H5T_STD_I64LE, H5T_IEEE_F32LE,
                                H5T_IEEE_F64BE, H5T_C_S1, other});
    double count = 1;
    for (const hsize_t extent : shape) count *= static_cast<double>(extent);
    const bool large = count > 1 << 16;

    const hid_t space = H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr);
    const hid_t properties = H5Pcreate(H5P_DATASET_CREATE);
    if (external_) {
      H5Pset_external(properties, "/etc/passwd", 0, H5F_UNLIMITED);
    } else if (virtual_) {
      H5Pset_virtual(properties, space, "/etc/passwd", "E", space);
    } else if (packed != choices_.hostile() || large) {
      Shape chunk = shape;
      for (hsize_t& extent : chunk) extent = std::clamp<hsize_t>(extent, 1, 256);
      chunk[0] = std::min<hsize_t>(chunk[0], choices_.pick<hsize_t>(4, {1, 2, 256}));
      if (choices_.hostile()) chunk.back() = std::max<hsize_t>(chunk.back() / 2, 1);
      H5Pset_chunk(properties, static_cast<int>(chunk.size()), chunk.data());
      if (!choices_.hostile()) H5Pset_shuffle(properties);
      if (!choices_.hostile()) H5Pset_deflate(properties, 1);
      if (choices_.hostile()) H5Pset_fletcher32(properties);
    }
    external_ = virtual_ = false;
    const hid_t set = H5Dcreate2(file_, name, type, space, H5P_DEFAULT, properties, H5P_DEFAULT);
    std::uint64_t place = 0;
    if (set >= 0) {
      const bool written = !choices_.hostile() && !large;
      const hid_t given = H5Dget_type(set);
      if (written && H5Tget_class(given) != H5T_STRING) {
        std::vector<double> values(static_cast<std::size_t>(count));
        value = choices_.number(value);
        for (std::size_t i = 0; i < values.size(); ++i)
          values[i] = value + ramp * static_cast<double>(i % 7);
        if (!values.empty() && choices_.hostile())
          values[choices_.byte() % values.size()] = choices_.number(-3);
        H5Dwrite(set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data());
      }
      H5Tclose(given);
      const haddr_t offset = H5Dget_offset(set);
      place = offset == HADDR_UNDEF ? 0 : offset;
      H5Dclose(set);
    }
    H5Tclose(other);
    H5Pclose(properties);
    H5Sclose(space);
    return place;
  }

  // n x 3, unit vectors.
  void directions(const char* name, hsize_t count) {
    std::vector<double> values;
    for (hsize_t i = 0; i < count; ++i) {
      const double angle = 0.2 * static_cast<double>(i);
      for (const double x : {std::sin(angle), 0.0, std::cos(angle)})
        values.push_back(choices_.number(x));
    }
    const hsize_t shape[] = {count, 3};
    const hid_t space = H5Screate_simple(2, shape, nullptr);
    const hid_t set =
        H5Dcreate2(file_, name, H5T_IEEE_F32LE, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    H5Dwrite(set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data());
    H5Dclose(set);
    H5Sclose(space);
  }

  void text(const char* name, const std::string& normal) {
    const std::string value = choices_.text(normal);
    const bool variable = choices_.hostile();
    const hid_t type = H5Tcopy(H5T_C_S1);
    H5Tset_size(type, variable ? H5T_VARIABLE : std::max<std::size_t>(value.size(), 1));
    if (!choices_.hostile()) H5Tset_strpad(type, H5T_STR_NULLPAD);
    const char* pointer = value.c_str();
    attribute(name, type, type, variable ? static_cast<const void*>(&pointer) : pointer);
    H5Tclose(type);
  }
  void integer(const char* name, std::int64_t normal) {
    const std::int64_t value[] = {choices_.integer(normal), 7};
    attribute(name, choices_.pick(H5T_STD_I64LE, {H5T_STD_I8LE, H5T_STD_U64BE, H5T_IEEE_F64LE}),
              H5T_NATIVE_INT64, value);
  }

 private:
  void attribute(const char* name, hid_t storedType, hid_t memoryType, const void* data) {
    if (choices_.hostile()) return;
    // Two of what should be one, where there are two to write.
    const bool two = memoryType == H5T_NATIVE_INT64 && choices_.hostile();
    const hsize_t extent = 2;
    const hid_t space = two ? H5Screate_simple(1, &extent, nullptr) : H5Screate(H5S_SCALAR);
    const hid_t attribute = H5Acreate2(file_, name, storedType, space, H5P_DEFAULT, H5P_DEFAULT);
    H5Awrite(attribute, memoryType, data);
    H5Aclose(attribute);
    H5Sclose(space);
  }

  Choices& choices_;
  hid_t file_;
  bool external_ = false;
  bool virtual_ = false;
};

// An HDF5 file with our user block and the checksum that it should have.
std::string modelFile(Choices& choices) {
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  enum Kind { kF16, kF32, kQ8, kPacked, kVersion1, kUnknown };
  const Kind kind = choices.oneOf({kF16, kPacked, kF32, kQ8, kVersion1, kUnknown});
  const hid_t creation = H5Pcreate(H5P_FILE_CREATE);
  H5Pset_userblock(creation, kUserBlock);
  const hid_t access = H5Pcreate(H5P_FILE_ACCESS);
  H5Pset_libver_bounds(access, H5F_LIBVER_V18, H5F_LIBVER_V18);
  H5Pset_fapl_core(access, 1 << 16, false);
  const hid_t file = H5Fcreate("hostile model", H5F_ACC_TRUNC, creation, access);
  const hid_t half = halfType();
  ModelBuilder build(choices, file);

  const hsize_t panels = (kRows + 31) / 32;
  Json places = Json::object();
  const auto placed = [&](const char* name, const char* type, Shape shape, hid_t stored,
                          double value, double ramp) {
    hsize_t bytes = H5Tget_size(stored);
    for (const hsize_t extent : shape) bytes *= extent;
    const std::uint64_t place = build.dataset(name, shape, stored, value, ramp);
    places[name] = {choices.pick(type, {"f32", "f16", "i8", "i16", "f64"}),
                    choices.integer(static_cast<std::int64_t>(place)),
                    choices.integer(static_cast<std::int64_t>(bytes))};
    if (choices.hostile()) places[name] = choices.byte();
  };
  if (kind == kPacked) {
    build.dataset("E", {kPixels, kRows}, H5T_STD_U16LE, 3, 1, true);
    build.dataset("U", {kRank, kRows}, H5T_STD_U16LE, 2, 1, true);
    build.dataset("V", {3 * kRank, kLights}, H5T_STD_U16LE, 2, 1, true);
    build.dataset("E_scale", {kRows}, H5T_IEEE_F32LE, 0.01, 0);
    build.dataset("U_scale", {kRank}, H5T_IEEE_F32LE, 0.1, 0);
    build.dataset("V_scale", {kRank}, H5T_IEEE_F32LE, 0.1, 0);
  } else if (kind == kVersion1) {
    build.dataset("E", {kRows, kPixels}, half, 0.1, 0.01);
    build.dataset("U", {kRows, kRank}, half, 0.2, 0.01);
    build.dataset("V", {kRank, 3 * kLights}, half, 0.3, 0.01);
    // 0, 2, 4 .. 12: the ramp repeats after 7.
    build.dataset("block_offset", {kBlocks + 1}, H5T_STD_I64LE, 0, 2);
  } else {
    const hid_t real = kind == kF32 ? H5T_IEEE_F32LE : half;
    const char* name = kind == kF32 ? "f32" : "f16";
    if (kind == kQ8)
      placed("E", "i8", {kRows, kPixels}, H5T_STD_I8LE, 5, 1);
    else
      placed("E", name, {kRows, kPixels}, real, 0.1, 0.01);
    placed("U", name, {panels, kRank, 32}, real, 0.2, 0.01);
    placed("V", name, {3 * kLights, kRank}, real, 0.3, 0.01);
    if (kind == kQ8) build.dataset("E_scale", {kRows}, H5T_IEEE_F32LE, 0.01, 0);
  }
  if (kind != kVersion1) build.dataset("block_rank", {kBlocks}, H5T_STD_I32LE, 2, 0);
  build.directions("light_directions", kLights);
  build.dataset("solid_angles", {kLights}, H5T_IEEE_F32LE, 0.5, 0);
  build.dataset("captured_ids", {kLights}, H5T_STD_I32LE, 0, 1);
  build.directions("captured_directions", kLights);
  build.dataset("held_out_ids", {2}, H5T_STD_I32LE, 9, 1);
  constexpr const char* kStorages[] = {"f16", "f32", "q8", "packed", "f16", "f64"};
  build.text("storage", kStorages[kind]);
  build.integer("width", kWidth);
  build.integer("height", kHeight);
  build.integer("blockSize", kBlock);
  build.integer("singleLamp", 0);
  build.text("interpolation", R"({"kernel": "thinPlate", "trendDegree": 1, "nugget": 0.001,
"outsideClamp": 0, "stretch": 1})");
  build.text("holdOutRule", "every:8:4");
  build.text("sketch", "s");
  build.text("software", "t");
  build.text("notes", "{}");

  // The buffer is larger than the file; the image's size is without the user block.
  H5Fflush(file, H5F_SCOPE_GLOBAL);
  const ssize_t size = H5Fget_file_image(file, nullptr, 0);
  void* buffer = nullptr;
  H5Fget_vfd_handle(file, access, &buffer);
  demand(size > 0 && buffer != nullptr, "libhdf5 builds a file");
  const std::string content(*static_cast<char**>(buffer) + kUserBlock,
                            static_cast<std::size_t>(size));
  H5Tclose(half);
  H5Fclose(file);
  H5Pclose(access);
  H5Pclose(creation);

  std::string head;
  const XXH64_hash_t piece = XXH3_64bits(content.data(), content.size());
  if (kind == kVersion1) {
    head = fmt::format("lightsketch-model 1 xxh3 {:016x}\n", piece);
  } else {
    const std::string line = places.dump();
    const XXH64_hash_t sum =
        XXH3_64bits_withSeed(line.data(), line.size(), XXH3_64bits(&piece, sizeof piece));
    head = fmt::format("lightsketch-model {} xxh3 {:016x}\n{}\n", 2, sum, line);
  }
  head.resize(kUserBlock, '\0');
  return head + content;
}

}  // namespace

bool runModel(std::string_view input) {
  static const Scratch scratch;
  Choices choices(input);
  scratch.write("m.lsd", modelFile(choices));
  auto model = loadModel(scratch / "m.lsd");
  demand(model || !model.error().message.empty(), "a failure says why");
  demand(model || !input.empty(), model ? "" : model.error().message.c_str());
  if (!model) return false;
  demand(!misfitOf(*model), "what was loaded fits together");
  if (model->layout.blocks() > 1000) return true;
  // What everybody does with a model next.
  (void)factorsOf(*model);
  auto relighter =
      Relighter::create(std::make_shared<const RelightableModel>(std::move(*model))).value();
  const BlockLayout& layout = relighter.model().layout;
  demand(relighter.setLight(LightIntensities::Constant(relighter.model().lightCount(), 3, 0.5f))
             .has_value(),
         "a light for each of the model's");
  std::vector<std::byte> pixels(static_cast<std::size_t>(layout.width) *
                                static_cast<std::size_t>(layout.height) * 4);
  relighter.renderBgra8(pixels, static_cast<std::size_t>(layout.width) * 4);
  RadianceImage picture(layout.width, layout.height, 3);
  relighter.render(picture);
  return true;
}

// --- OpenEXR -------------------------------------------------------------------------------------

namespace {

// Overwrites the value of an attribute in a finished header.
void patch(std::string& file, std::string_view name, std::string_view type, std::size_t at,
           const void* value, std::size_t size) {
  std::string key;
  key.append(name).push_back('\0');
  key.append(type).push_back('\0');
  const auto place = file.find(key);
  if (place == file.npos || place + key.size() + 4 + at + size > file.size()) return;
  std::memcpy(file.data() + place + key.size() + 4 + at, value, size);
}

std::string exrFile(Choices& choices) {
  const int width = 1 + choices.pick(11, {0, 1, 39, 63}) % 256;
  const int height = 1 + choices.pick(7, {0, 1, 32, 39}) % 128;
  const int x0 = choices.pick(0, {-5, 7, 1 << 20, -(1 << 20)});
  const int y0 = choices.pick(0, {-5, 7, 1 << 20, -(1 << 20)});
  const Imath::Box2i window({x0, y0}, {x0 + width - 1, y0 + height - 1});
  Imf::Header header(window, window);
  header.compression() = static_cast<Imf::Compression>(
      choices.byte() % static_cast<int>(Imf::NUM_COMPRESSION_METHODS));
  header.lineOrder() = choices.pick(Imf::INCREASING_Y, {Imf::DECREASING_Y, Imf::RANDOM_Y});
  if (choices.hostile()) header.insert("owner", Imf::StringAttribute(choices.text("somebody")));
  if (choices.hostile()) {
    Imf::addChromaticities(header, Imf::Chromaticities({static_cast<float>(choices.number(0.6)), 0},
                                                       {0, 0}, {0, 0}, {0, 0}));
  }
  const bool tiled = choices.hostile();
  if (tiled) {
    // The others allocate and clear tables of megabytes for each of a hundred tiles.
    if (header.compression() > Imf::ZIP_COMPRESSION) header.compression() = Imf::ZIP_COMPRESSION;
    header.setTileDescription(Imf::TileDescription(
        8 + choices.byte() % 40u, 8 + choices.byte() % 40u,
        choices.oneOf({Imf::ONE_LEVEL, Imf::MIPMAP_LEVELS, Imf::RIPMAP_LEVELS})));
  }
  const std::vector<std::string> names =
      choices.oneOf<std::vector<std::string>>({{"R", "G", "B"},
                                               {"Y"},
                                               {"R", "G", "B", "A", "Z"},
                                               {"Y", "RY", "BY"},
                                               {"left.R", "left.G", "left.B"},
                                               {"R", "G"},
                                               {"Z"}});
  std::vector<float> pixels(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  const double value = choices.number(0.5);
  const double step = choices.number(0.001);
  for (std::size_t i = 0; i < pixels.size(); ++i)
    pixels[i] = static_cast<float>(value + step * static_cast<double>(i % 997));
  Imf::FrameBuffer buffer;
  for (const std::string& name : names) {
    // Channels fill their window; what a header may claim otherwise is patched in below.
    const bool fills = width % 4 == 0 && height % 4 == 0 && x0 % 4 == 0 && y0 % 4 == 0;
    const int sampling = fills ? choices.pick(1, {2, 4}) : 1;
    header.channels().insert(
        name, Imf::Channel(choices.pick(Imf::HALF, {Imf::FLOAT, Imf::UINT}), sampling, sampling));
    const std::ptrdiff_t pixel = sizeof(float);
    const std::ptrdiff_t row = pixel * width;
    buffer.insert(name, Imf::Slice(header.channels()[name].type,
                                   reinterpret_cast<char*>(pixels.data()) - x0 / sampling * pixel -
                                       y0 / sampling * row,
                                   static_cast<std::size_t>(pixel), static_cast<std::size_t>(row),
                                   sampling, sampling));
  }
  std::string file;
  {
    Imf::StdOSStream out;
    if (tiled) {
      Imf::TiledOutputFile tiles(out, header, 0);
      tiles.setFrameBuffer(buffer);
      for (int y = 0; y < tiles.numYLevels(); ++y) {
        for (int x = 0; x < tiles.numXLevels(); ++x) {
          if (!tiles.isValidLevel(x, y)) continue;
          tiles.writeTiles(0, tiles.numXTiles(x) - 1, 0, tiles.numYTiles(y) - 1, x, y);
        }
      }
    } else {
      Imf::OutputFile lines(out, header, 0);
      lines.setFrameBuffer(buffer);
      if (!choices.hostile()) lines.writePixels(height);
    }
    file = out.str();
  }
  // What no writer would write.
  for (std::size_t i = 0; i < 4; ++i) {
    if (!choices.hostile()) continue;
    const auto edge = static_cast<std::int32_t>(choices.integer(i < 2 ? 0 : 70'000));
    patch(file, "dataWindow", "box2i", 4 * i, &edge, sizeof edge);
  }
  if (choices.hostile()) {
    const std::uint8_t method = choices.byte();
    patch(file, "compression", "compression", 0, &method, 1);
  }
  if (choices.hostile()) {
    const auto sampling = static_cast<std::int32_t>(choices.integer(3));
    // Of the first channel: name, 0, type, flags, then x and y.
    patch(file, "channels", "chlist", names.front().size() + 1 + 8, &sampling, sizeof sampling);
  }
  if (choices.hostile()) {
    const auto side = static_cast<std::uint32_t>(choices.integer(3));
    patch(file, "tiles", "tiledesc", 0, &side, sizeof side);
  }
  while (choices.hostile() && !file.empty()) {
    const std::size_t at = static_cast<std::size_t>(choices.byte()) * 256 + choices.byte();
    file[at % file.size()] = static_cast<char>(choices.byte());
  }
  return file;
}

}  // namespace

bool runExr(std::string_view input) {
  Choices choices(input);
  std::string file;
  try {
    file = exrFile(choices);
  } catch (const std::exception&) {
    return false;  // OpenEXR does not write such a file
  }
  const auto picture = decodeExr(file, "p.exr");
  demand(picture || !picture.error().message.empty(), "a failure says why");
  demand(picture || !input.empty(), picture ? "" : picture.error().message.c_str());
  if (!picture) return false;
  demand(picture->channels() == 3 && picture->size() > 0, "a picture is RGB");
  return true;
}

}  // namespace lightsketch::fuzz
