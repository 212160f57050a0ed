// Models on disk. Plain ones (f32, f16, q8) lie in the file as they lie in memory, so that they are
// read in place by all cores; packed ones are integer datasets that HDF5's shuffle and deflate make
// small.
#include <fcntl.h>
#include <hdf5.h>
#include <libdeflate.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>
#include <unistd.h>
#include <xxhash.h>
#ifdef __x86_64__
#include <xxh_x86dispatch.h>  // the same, by AVX2 or AVX-512 where there is one
#endif
#include <zlib.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <mutex>
#include <new>
#include <optional>
#include <span>
#include <string_view>
#include <utility>

#include "capture/frame/descriptor.h"
#include "capture/frame/file.h"
#include "pipeline/compress/model.h"
#include "pipeline/compress/packed_code.h"
#include "pipeline/compress/scratch_file.h"

namespace lightsketch {
namespace {

namespace tbb = oneapi::tbb;

constexpr int kFormatVersion = 2;
constexpr const char* kFormat = "lightsketch-model";
// HDF5 leaves this many bytes at the file's start to us: a line with magic, version and checksum, a
// line of JSON that says where the factors lie, then zeros.
constexpr hsize_t kUserBlock = 1024;
constexpr const char* kReadMe =
    "Blocks are row-major over the picture, as are the p pixels of a block; block j has "
    "block_rank[j] "
    "basis pictures. Storage f32, f16, q8: E is rows x p, rows of a block together; U is panels x "
    "q x 32 "
    "(row r, column k: U[r // 32, k, r % 32]); V is 3n x q (row 3 i + c: light i, channel c). "
    "Storage "
    "packed: all are folded, x -> (x >> 1) ^ -(x & 1); rows stand in the order of their index "
    "within the block, all blocks' first rows, then the second ones; E is p x rows, each row's "
    "orthonormal DCT-II, coefficients by rising sum of frequencies, then by vertical frequency; U "
    "is q x rows; V is 3q x n, of each k (r + g + b) / sqrt 3, (r - b) / sqrt 2, "
    "(r - 2g + b) / sqrt 6. Times E_scale per row, U_scale and V_scale per k, where there are "
    "any. Under intensities s (n x 3): v = sum_i V[3 i + c] s[i, c]; "
    "block j, channel c = E_j^T (U_j v). Linear RGB; its square root if singleLamp.";

// The serial HDF5 library is not thread-safe.
std::mutex& hdf5Mutex() {
  static std::mutex mutex;
  return mutex;
}

// Owns an HDF5 identifier.
class Handle {
 public:
  Handle(hid_t id, herr_t (*closer)(hid_t)) : id_(id), close_(closer) {}
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  operator hid_t() const { return id_; }
  explicit operator bool() const { return id_ >= 0; }

 private:
  hid_t id_;
  herr_t (*close_)(hid_t);
};

// IEEE 754 half, which h5py knows as float16. Never converted by libhdf5, whose 1.10 loses the
// carry into the exponent when it rounds (0.24999 became 0.125).
hid_t makeHalfType() {
  const hid_t type = H5Tcopy(H5T_IEEE_F32LE);
  H5Tset_fields(type, 15, 10, 5, 0, 10);
  H5Tset_size(type, 2);
  H5Tset_ebias(type, 15);
  return type;
}

hid_t makeType(ElementType type) {
  switch (type) {
    case ElementType::kFloat32:
      return H5Tcopy(H5T_IEEE_F32LE);
    case ElementType::kFloat16:
      return makeHalfType();
    case ElementType::kInt8:
      return H5Tcopy(H5T_STD_I8LE);
    case ElementType::kInt16:
      return H5Tcopy(H5T_STD_I16LE);
  }
  return -1;
}

using Shape = std::vector<hsize_t>;
using Bytes = std::vector<std::byte>;

// Rows of a packed dataset that one call of deflate sees: large enough that its tables do not
// weigh, small enough that rows of other statistics have other tables.
hsize_t rowsPerChunk(hsize_t rows, hsize_t rowBytes) {
  constexpr hsize_t kBytes = hsize_t{1} << 15;
  return std::clamp<hsize_t>((kBytes + rowBytes - 1) / std::max<hsize_t>(rowBytes, 1), 1,
                             std::max<hsize_t>(rows, 1));
}

// Quantised factors hold next to no repetitions but runs of zeros. Looking for no other is 20 times
// faster, and 1 to 4 percent larger, which matters where the whole is small.
int strategyFor(const RelightableModel& model) {
  constexpr std::size_t kSmall = std::size_t{1} << 23;
  return model.factorBytes() < kSmall ? Z_FILTERED : Z_RLE;
}

Bytes deflate(const Bytes& in, int strategy) {
  constexpr int kMost = 9;  // of level and of memory
  z_stream stream{};
  if (deflateInit2(&stream, kMost, Z_DEFLATED, 15, kMost, strategy) != Z_OK) throw std::bad_alloc();
  Bytes out(deflateBound(&stream, in.size()));
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<std::byte*>(in.data()));
  stream.avail_in = static_cast<uInt>(in.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(out.size());
  ::deflate(&stream, Z_FINISH);
  out.resize(stream.total_out);
  deflateEnd(&stream);
  return out;
}

hid_t datasetProperties() {
  const hid_t properties = H5Pcreate(H5P_DATASET_CREATE);
  H5Pset_dset_no_attrs_hint(properties, true);  // no room for attributes in each header
  return properties;
}

// Writes datasets and attributes; the first failure makes all that follows void.
class Writer {
 public:
  // `plainLists`: nothing is deflated.
  Writer(hid_t file, bool plainLists) : file_(file), plainLists_(plainLists) {}
  bool ok() const { return ok_; }

  // As it is, in one piece. Returns the dataset's place behind the user block.
  std::uint64_t plain(const char* name, const Shape& shape, hid_t type, const void* data) {
    const Handle space(H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr),
                       H5Sclose);
    const Handle properties(datasetProperties(), H5Pclose);
    const Handle set(H5Dcreate2(file_, name, type, space, H5P_DEFAULT, properties, H5P_DEFAULT),
                     H5Dclose);
    check(set);
    if (ok_ && H5Sget_simple_extent_npoints(space) > 0)
      check(H5Dwrite(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data));
    const haddr_t place = ok_ ? H5Dget_offset(set) : HADDR_UNDEF;
    return place == HADDR_UNDEF ? 0 : place;
  }

  // Through shuffle and deflate, on all cores.
  void packed(const char* name, const Shape& shape, std::span<const std::uint16_t> values,
              int strategy) {
    if (values.empty()) {
      plain(name, shape, H5T_STD_U16LE, nullptr);
      return;
    }
    const hsize_t step = rowsPerChunk(shape[0], shape[1] * sizeof(std::uint16_t));
    const std::size_t chunks = (shape[0] + step - 1) / step;
    std::vector<Bytes> deflated(chunks);
    tbb::enumerable_thread_specific<std::pair<std::vector<std::uint16_t>, Bytes>> buffers;
    tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t c) {
      // Chunks are all of one size; the last is filled up with zeros.
      auto& [numbers, planes] = buffers.local();
      numbers.assign(step * shape[1], 0);
      const std::size_t from = c * numbers.size();
      std::copy_n(values.begin() + static_cast<std::ptrdiff_t>(from),
                  std::min(numbers.size(), values.size() - from), numbers.begin());
      planes.resize(numbers.size() * sizeof(std::uint16_t));
      splitBytes(numbers, planes.data(), planes.data() + numbers.size());
      deflated[c] = deflate(planes, strategy);
    });
    const Handle space(H5Screate_simple(2, shape.data(), nullptr), H5Sclose);
    const Handle properties(datasetProperties(), H5Pclose);
    const hsize_t chunkShape[] = {step, shape[1]};
    check(H5Pset_chunk(properties, 2, chunkShape));
    check(H5Pset_shuffle(properties));
    check(H5Pset_deflate(properties, 9));
    const Handle set(
        H5Dcreate2(file_, name, H5T_STD_U16LE, space, H5P_DEFAULT, properties, H5P_DEFAULT),
        H5Dclose);
    check(set);
    for (std::size_t c = 0; c < chunks && ok_; ++c) {
      const hsize_t place[] = {c * step, 0};
      check(H5Dwrite_chunk(set, H5P_DEFAULT, 0, place, deflated[c].size(), deflated[c].data()));
    }
  }

  // Short lists: through shuffle and deflate by libhdf5 where that is smaller than its bookkeeping
  // and the factors are not so large that only its time counts.
  template <class T>
  void list(const char* name, const Shape& shape, hid_t storedType, hid_t memoryType,
            const std::vector<T>& values) {
    const Handle space(H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr),
                       H5Sclose);
    const Handle properties(datasetProperties(), H5Pclose);
    constexpr std::size_t kSmall = 512;
    if (values.size() * sizeof(T) <= kSmall) {
      check(H5Pset_layout(properties, H5D_COMPACT));
    } else if (!plainLists_) {
      check(H5Pset_chunk(properties, static_cast<int>(shape.size()), shape.data()));
      check(H5Pset_shuffle(properties));
      check(H5Pset_deflate(properties, 9));
    }
    const Handle set(
        H5Dcreate2(file_, name, storedType, space, H5P_DEFAULT, properties, H5P_DEFAULT), H5Dclose);
    check(set);
    if (ok_ && !values.empty())
      check(H5Dwrite(set, memoryType, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()));
  }
  void list(const char* name, const std::vector<float>& values) {
    list(name, {values.size()}, H5T_IEEE_F32LE, H5T_NATIVE_FLOAT, values);
  }
  void list(const char* name, const std::vector<int>& values) {
    list(name, {values.size()}, H5T_STD_I32LE, H5T_NATIVE_INT, values);
  }
  void directions(const char* name, const std::vector<Eigen::Vector3d>& values) {
    std::vector<float> numbers;
    for (const auto& d : values)
      for (const double x : d) numbers.push_back(static_cast<float>(x));
    list(name, {values.size(), 3}, H5T_IEEE_F32LE, H5T_NATIVE_FLOAT, numbers);
  }

  void text(const char* name, const std::string& value) {
    const Handle type(H5Tcopy(H5T_C_S1), H5Tclose);
    H5Tset_size(type, std::max<std::size_t>(value.size(), 1));
    H5Tset_strpad(type, H5T_STR_NULLPAD);
    H5Tset_cset(type, H5T_CSET_UTF8);
    attribute(name, type, type, value.c_str());
  }
  void integer(const char* name, std::int64_t value) {
    attribute(name, H5T_STD_I64LE, H5T_NATIVE_INT64, &value);
  }

 private:
  void check(hid_t result) { ok_ = ok_ && result >= 0; }
  void attribute(const char* name, hid_t storedType, hid_t memoryType, const void* data) {
    const Handle space(H5Screate(H5S_SCALAR), H5Sclose);
    const Handle attribute(H5Acreate2(file_, name, storedType, space, H5P_DEFAULT, H5P_DEFAULT),
                           H5Aclose);
    check(attribute);
    if (ok_) check(H5Awrite(attribute, memoryType, data));
  }

  hid_t file_;
  bool plainLists_;
  bool ok_ = true;
};

constexpr const char* kKernelNames[] = {"thinPlate", "linear", "cubic"};

Json toJson(const InterpolationSettings& settings) {
  return {{"kernel", kKernelNames[static_cast<int>(settings.kernel)]},
          {"trendDegree", settings.trendDegree},
          {"nugget", settings.nugget},
          {"outsideClamp", settings.outsideClamp},
          {"stretch", settings.stretch}};
}

Result<InterpolationSettings> interpolationFrom(const Json& json, const std::string& where) {
  InterpolationSettings settings;
  ASSIGN_OR_RETURN(const std::string name, jsonString(json, "kernel", where));
  const auto kernel = std::find(std::begin(kKernelNames), std::end(kKernelNames), name);
  if (kernel == std::end(kKernelNames)) {
    return failure(ErrorCode::kUnsupported, "{}: interpolation kernel '{}' is unknown", where,
                   name);
  }
  settings.kernel = static_cast<InterpolationSettings::Kernel>(kernel - std::begin(kKernelNames));
  ASSIGN_OR_RETURN(const std::int64_t degree, jsonInteger(json, "trendDegree", where, 0, 3));
  settings.trendDegree = static_cast<int>(degree);
  ASSIGN_OR_RETURN(settings.nugget, jsonNumber(json, "nugget", where));
  ASSIGN_OR_RETURN(settings.outsideClamp, jsonNumber(json, "outsideClamp", where));
  if (json.contains("stretch")) {  // not in version 1
    ASSIGN_OR_RETURN(settings.stretch, jsonNumber(json, "stretch", where));
  }
  return settings;
}

// --- The user block ------------------------------------------------------------------------------

// One factor of a plain file: where its bytes lie.
struct Place {
  ElementType type = ElementType::kFloat32;
  std::uint64_t offset = 0;
  std::uint64_t bytes = 0;
};
using Places = std::array<Place, 3>;  // E, U, V
constexpr const char* kFactorNames[] = {"E", "U", "V"};
constexpr const char* kTypeNames[] = {"f32", "f16", "i8", "i16"};

std::string placesLine(const std::optional<Places>& places) {
  Json json = Json::object();
  for (std::size_t i = 0; places && i < places->size(); ++i) {
    const Place& place = (*places)[i];
    json[kFactorNames[i]] = {kTypeNames[static_cast<int>(place.type)], place.offset, place.bytes};
  }
  return json.dump();
}

// What lies behind the user block is hashed in pieces, so that all cores can; XXH3 of the pieces'
// XXH3 and of the line with the factors' places is the file's checksum.
constexpr std::uint64_t kPiece = std::uint64_t{1} << 22;

std::string checksumOf(const std::vector<std::uint64_t>& pieces, const std::string& places) {
  XXH64_hash_t hash = XXH3_64bits(pieces.data(), pieces.size() * sizeof(std::uint64_t));
  hash = XXH3_64bits_withSeed(places.data(), places.size(), hash);
  return fmt::format("{:016x}", hash);
}

std::string userBlock(const std::string& checksum, const std::string& places) {
  return fmt::format("{} {} xxh3 {}\n{}\n", kFormat, kFormatVersion, checksum, places);
}

// --- Writing -------------------------------------------------------------------------------------

// The whole HDF5 file, built in memory: libhdf5 1.10 crashes when a disk fills up under it. Calls
// use(bytes, places) with a zeroed user block in front. False if libhdf5 failed.
template <class Use>
bool buildFile(const RelightableModel& model, Use use) {
  const Handle creation(H5Pcreate(H5P_FILE_CREATE), H5Pclose);
  H5Pset_userblock(creation, kUserBlock);
  // Small indices and no heaps: they would take more than a small model's factors.
  H5Pset_istore_k(creation, 4);
  H5Pset_link_phase_change(creation, 64, 32);
  H5Pset_attr_phase_change(creation, 64, 32);
  const Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
  // Fewer bytes for bookkeeping than the oldest format. The newest one marks a file that is open,
  // as this one still is when it is copied.
  H5Pset_libver_bounds(access, H5F_LIBVER_V18, H5F_LIBVER_V18);
  const std::size_t increment =
      std::max<std::size_t>(model.factorBytes() / 4, std::size_t{1} << 20);
  H5Pset_fapl_core(access, increment, false);
  const Handle file(H5Fcreate("model in memory", H5F_ACC_TRUNC, creation, access), H5Fclose);
  if (!file) return false;
  Writer writer(file, model.storage != Storage::kPacked);
  std::optional<Places> places;
  if (model.storage == Storage::kPacked) {
    const PackedCode& code = *model.code;
    const auto rows = static_cast<hsize_t>(model.rows());
    const auto q = static_cast<hsize_t>(model.rank);
    const int strategy = strategyFor(model);
    writer.packed("E", {static_cast<hsize_t>(model.layout.pixelsPerBlock()), rows}, code.E,
                  strategy);
    writer.packed("U", {q, rows}, code.U, strategy);
    writer.packed("V", {3 * q, static_cast<hsize_t>(model.lightCount())}, code.V, strategy);
    writer.list("E_scale", code.stepE);
    writer.list("U_scale", code.stepU);
    writer.list("V_scale", code.stepV);
  } else {
    const auto q = static_cast<hsize_t>(model.rank);
    const auto n = static_cast<hsize_t>(model.lightCount());
    const StoredFactor* factors[] = {&model.E, &model.U, &model.V};
    const Shape shapes[] = {
        {static_cast<hsize_t>(model.rows()), static_cast<hsize_t>(model.layout.pixelsPerBlock())},
        {static_cast<hsize_t>(model.panels()), q, hsize_t{RelightableModel::kPanelRows}},
        {3 * n, q}};
    places.emplace();
    for (std::size_t i = 0; i < 3; ++i) {
      const FactorValues& values = factors[i]->values;
      const Handle type(makeType(values.type()), H5Tclose);
      (*places)[i] = {values.type(), writer.plain(kFactorNames[i], shapes[i], type, values.data()),
                      values.bytes()};
    }
    if (!model.E.scale.empty())
      writer.plain("E_scale", {model.E.scale.size()}, H5T_IEEE_F32LE, model.E.scale.data());
  }
  std::vector<int> ranks;
  for (std::size_t j = 0; j + 1 < model.blockOffset.size(); ++j)
    ranks.push_back(static_cast<int>(model.blockOffset[j + 1] - model.blockOffset[j]));
  writer.list("block_rank", ranks);
  writer.directions("light_directions", model.lights);
  writer.list("solid_angles",
              std::vector<float>(model.solidAngles.begin(), model.solidAngles.end()));
  writer.list("captured_ids", model.capturedIds);
  writer.directions("captured_directions", model.capturedDirections);
  writer.list("held_out_ids", model.heldOutIds);
  writer.text("format", kFormat);
  writer.integer("formatVersion", kFormatVersion);
  writer.text("readme", kReadMe);
  writer.text("storage", nameOf(model.storage));
  writer.integer("width", model.layout.width);
  writer.integer("height", model.layout.height);
  writer.integer("blockSize", model.layout.blockSize);
  writer.integer("singleLamp", model.singleLamp);
  writer.text("interpolation", toJson(model.interpolation).dump());
  writer.text("holdOutRule", model.holdOutRule);
  writer.text("sketch", model.sketch);
  writer.text("software", model.software);
  writer.text("notes", model.notes.dump());
  void* handle = nullptr;
  if (!writer.ok() || H5Fflush(file, H5F_SCOPE_GLOBAL) < 0 ||
      H5Fget_vfd_handle(file, access, &handle) < 0) {
    return false;
  }
  // The buffer is larger than the file; the image's size is without the user block.
  const ssize_t image = H5Fget_file_image(file, nullptr, 0);
  if (image <= 0) return false;
  use(std::span(static_cast<char*>(*static_cast<void**>(handle)),
                kUserBlock + static_cast<std::size_t>(image)),
      places);
  return true;
}

// --- Reading -------------------------------------------------------------------------------------

// What the user block says, before libhdf5 has seen the file.
struct Head {
  int version = 0;
  std::uint64_t fileBytes = 0;
  std::string checksum;
  std::string placesLine;
  std::optional<Places> places;  // of a plain file
};

std::optional<ElementType> elementTypeNamed(const std::string& name) {
  for (std::size_t i = 0; i < std::size(kTypeNames); ++i)
    if (name == kTypeNames[i]) return static_cast<ElementType>(i);
  return std::nullopt;
}

// The factors' places, if they are three ranges of whole numbers inside the file.
std::optional<Places> placesFrom(const Json& json, std::uint64_t fileBytes) {
  Places places;
  for (std::size_t i = 0; i < places.size(); ++i) {
    const auto entry = json.find(kFactorNames[i]);
    if (entry == json.end() || !entry->is_array() || entry->size() != 3 ||
        !(*entry)[0].is_string() || !(*entry)[1].is_number_unsigned() ||
        !(*entry)[2].is_number_unsigned()) {
      return std::nullopt;
    }
    const auto type = elementTypeNamed((*entry)[0].get<std::string>());
    if (!type) return std::nullopt;
    places[i] = {*type, (*entry)[1].get<std::uint64_t>(), (*entry)[2].get<std::uint64_t>()};
    if (places[i].bytes % bytesOf(*type) != 0 || places[i].bytes > fileBytes ||
        places[i].offset > fileBytes - places[i].bytes ||
        (places[i].bytes > 0 && places[i].offset < kUserBlock)) {
      return std::nullopt;
    }
  }
  return places;
}

Result<Head> readHead(int fd, const std::filesystem::path& path) {
  std::array<char, kUserBlock> block{};
  const ssize_t count = ::pread(fd, block.data(), block.size() - 1, 0);
  if (count < 0) {
    return failure(ErrorCode::kIo, "{}: cannot read: {}", path.string(), systemMessage(errno));
  }
  Head head;
  char found[17] = {};
  const int fields =
      std::sscanf(block.data(), "lightsketch-model %d xxh3 %16[0-9a-f]", &head.version, found);
  if (fields < 1) {
    return failure(ErrorCode::kCorrupt, "{}: not a lightsketch model, or its beginning is damaged",
                   path.string());
  }
  if (head.version > kFormatVersion) {
    return failure(
        ErrorCode::kUnsupported,
        "{}: format version {} is newer than {}, the newest that this program reads; update it",
        path.string(), head.version, kFormatVersion);
  }
  const auto damaged = [&] {
    return failure(ErrorCode::kCorrupt,
                   "{}: damaged or truncated: its content does not have the checksum it should",
                   path.string());
  };
  const off_t size = ::lseek(fd, 0, SEEK_END);
  if (fields != 2 || head.version < 1 || size < static_cast<off_t>(kUserBlock)) return damaged();
  head.fileBytes = static_cast<std::uint64_t>(size);
  head.checksum = found;
  if (head.version == 1) return head;
  const std::string text(block.data());
  const std::size_t lineEnd = text.find('\n');
  const std::size_t secondEnd =
      lineEnd == std::string::npos ? lineEnd : text.find('\n', lineEnd + 1);
  if (secondEnd == std::string::npos) return damaged();
  head.placesLine = text.substr(lineEnd + 1, secondEnd - lineEnd - 1);
  if (userBlock(head.checksum, head.placesLine) != text) return damaged();
  const Json json = Json::parse(head.placesLine, nullptr, false);
  if (!json.is_object()) return damaged();
  if (!json.empty()) {
    head.places = placesFrom(json, head.fileBytes);
    if (!head.places) return damaged();
  }
  return head;
}

// Reads everything behind the user block once, all cores, factors straight to where they stay, and
// compares the checksum.
Result<void> readAndVerify(int fd, const Head& head, const std::filesystem::path& path,
                           std::array<FactorValues, 3>& factors) {
  for (std::size_t i = 0; head.places && i < factors.size(); ++i) {
    const Place& place = (*head.places)[i];
    factors[i] = FactorValues(place.type, place.bytes / bytesOf(place.type));
  }
  const std::uint64_t pieces = (head.fileBytes - kUserBlock + kPiece - 1) / kPiece;
  std::vector<std::uint64_t> hashes(pieces);
  std::atomic<int> error = 0;
  tbb::parallel_for(std::uint64_t{0}, pieces, [&](std::uint64_t k) {
    const auto end = std::min<std::uint64_t>(head.fileBytes, kUserBlock + (k + 1) * kPiece);
    const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(),
                                                                         XXH3_freeState);
    XXH3_64bits_reset(state.get());
    Bytes other;
    for (std::uint64_t at = kUserBlock + k * kPiece; at < end && error == 0;) {
      // Up to where the next factor begins or this one ends.
      std::uint64_t until = std::min(end, at + (std::uint64_t{1} << 18));
      std::byte* to = nullptr;
      for (std::size_t i = 0; head.places && i < factors.size(); ++i) {
        const Place& place = (*head.places)[i];
        if (at >= place.offset && at < place.offset + place.bytes) {
          to = factors[i].data() + (at - place.offset);
          until = std::min(until, place.offset + place.bytes);
        } else if (at < place.offset) {
          until = std::min(until, place.offset);
        }
      }
      if (!to) {
        other.resize(until - at);
        to = other.data();
      }
      if (const int failed = readAll(fd, to, until - at, static_cast<std::int64_t>(at)))
        error = failed;
      XXH3_64bits_update(state.get(), to, until - at);
      at = until;
    }
    hashes[k] = XXH3_64bits_digest(state.get());
  });
  if (error != 0) {
    return failure(ErrorCode::kIo, "{}: cannot read: {}", path.string(), systemMessage(error));
  }
  if (checksumOf(hashes, head.placesLine) != head.checksum) {
    return failure(ErrorCode::kCorrupt,
                   "{}: damaged or truncated: its content does not have the checksum it should",
                   path.string());
  }
  return {};
}

// Reads datasets and attributes, checked for shape before anything is allocated.
class Reader {
 public:
  Reader(hid_t file, const std::filesystem::path& path, std::uint64_t maxBytes)
      : file_(file), where_(path.string()), maxBytes_(maxBytes) {}

  Result<Shape> shape(const char* name, int dimensions) {
    // Its numbers must lie in this file: libhdf5 would open others that a link or dataset names.
    H5L_info_t link{};
    if (H5Lget_info(file_, name, &link, H5P_DEFAULT) < 0 || link.type != H5L_TYPE_HARD)
      return failure(ErrorCode::kCorrupt, "{}: dataset {} is missing", where_, name);
    const Handle set(H5Dopen2(file_, name, H5P_DEFAULT), H5Dclose);
    if (!set) return failure(ErrorCode::kCorrupt, "{}: dataset {} is missing", where_, name);
    const Handle properties(H5Dget_create_plist(set), H5Pclose);
    if (!properties || H5Pget_external_count(properties) != 0 ||
        H5Pget_layout(properties) == H5D_VIRTUAL) {
      return failure(ErrorCode::kCorrupt, "{}: the numbers of dataset {} lie in another file",
                     where_, name);
    }
    const Handle space(H5Dget_space(set), H5Sclose);
    if (H5Sget_simple_extent_ndims(space) != dimensions) {
      return failure(ErrorCode::kCorrupt, "{}: dataset {} does not have {} dimensions", where_,
                     name, dimensions);
    }
    Shape shape(static_cast<std::size_t>(dimensions));
    H5Sget_simple_extent_dims(space, shape.data(), nullptr);
    const Handle type(H5Dget_type(set), H5Tclose);
    std::uint64_t bytes = std::max<std::uint64_t>(H5Tget_size(type), 1);
    for (const hsize_t extent : shape) {
      if (extent > maxBytes_ / bytes) {
        return failure(ErrorCode::kCorrupt,
                       "{}: dataset {} claims more values than the file can hold", where_, name);
      }
      bytes *= std::max<hsize_t>(extent, 1);
    }
    return shape;
  }

  Result<void> values(const char* name, hid_t memoryType, void* data) {
    const Handle set(H5Dopen2(file_, name, H5P_DEFAULT), H5Dclose);
    if (!set || H5Dread(set, memoryType, H5S_ALL, H5S_ALL, H5P_DEFAULT, data) < 0) {
      return failure(ErrorCode::kCorrupt, "{}: dataset {} cannot be read", where_, name);
    }
    return {};
  }

  hid_t file() const { return file_; }

  template <class T>
  Result<std::vector<T>> list(const char* name, hid_t memoryType) {
    ASSIGN_OR_RETURN(const Shape extents, shape(name, 1));
    std::vector<T> result(extents[0]);
    RETURN_IF_ERROR(values(name, memoryType, result.data()));
    return result;
  }

  Result<std::vector<Eigen::Vector3d>> directions(const char* name) {
    ASSIGN_OR_RETURN(const Shape extents, shape(name, 2));
    if (extents[1] != 3)
      return failure(ErrorCode::kCorrupt, "{}: dataset {} is not n x 3", where_, name);
    std::vector<Eigen::Vector3d> result(extents[0]);
    if (!result.empty()) RETURN_IF_ERROR(values(name, H5T_NATIVE_DOUBLE, result.data()));
    for (auto& d : result) {
      if (!(std::abs(d.norm() - 1) < 1e-6)) {
        return failure(ErrorCode::kCorrupt,
                       "{}: dataset {} holds a direction that is not of unit length", where_, name);
      }
      d.normalize();
    }
    return result;
  }

  // Empty if the dataset is not there.
  Result<std::vector<float>> scales(const char* name) {
    if (H5Lexists(file_, name, H5P_DEFAULT) <= 0) return std::vector<float>();
    ASSIGN_OR_RETURN(auto result, list<float>(name, H5T_NATIVE_FLOAT));
    // Zero times what is not finite is not a number; in vectors.
    const Eigen::Map<const Eigen::ArrayXf> all(result.data(),
                                               static_cast<Eigen::Index>(result.size()));
    if (std::isnan((all * 0).sum()))
      return failure(ErrorCode::kCorrupt, "{}: dataset {} is not finite", where_, name);
    return result;
  }

  Result<std::string> text(const char* name) {
    const Handle attribute(H5Aopen(file_, name, H5P_DEFAULT), H5Aclose);
    const Handle type(attribute ? H5Aget_type(attribute) : -1, H5Tclose);
    if (!type || !isScalar(attribute) || H5Tget_class(type) != H5T_STRING ||
        H5Tis_variable_str(type) > 0) {
      return failure(ErrorCode::kCorrupt, "{}: text attribute {} is missing", where_, name);
    }
    std::string value(H5Tget_size(type), '\0');
    if (H5Aread(attribute, type, value.data()) < 0) {
      return failure(ErrorCode::kCorrupt, "{}: attribute {} cannot be read", where_, name);
    }
    value.resize(std::strlen(value.c_str()));
    return value;
  }

  Result<int> integer(const char* name, std::int64_t min, std::int64_t max) {
    const Handle attribute(H5Aopen(file_, name, H5P_DEFAULT), H5Aclose);
    const Handle type(attribute ? H5Aget_type(attribute) : -1, H5Tclose);
    std::int64_t value = 0;
    if (!type || !isScalar(attribute) || H5Tget_class(type) != H5T_INTEGER ||
        H5Aread(attribute, H5T_NATIVE_INT64, &value) < 0 || value < min || value > max) {
      return failure(ErrorCode::kCorrupt, "{}: attribute {} is missing or not from {} to {}",
                     where_, name, min, max);
    }
    return static_cast<int>(value);
  }

 private:
  // One value, so that reading it fills one and no more.
  static bool isScalar(hid_t attribute) {
    const Handle space(H5Aget_space(attribute), H5Sclose);
    return space && H5Sget_simple_extent_npoints(space) == 1;
  }

  hid_t file_;
  std::string where_;
  std::uint64_t maxBytes_;
};

// A packed dataset: chunks read one after the other, inflated by all cores. Calls
// line(k, its lower bytes, its upper bytes) for every line, on any thread.
template <class Line>
Result<void> readPacked(Reader& reader, const char* name, const Shape& shape,
                        const std::string& where, const Line& line) {
  if (shape[0] * shape[1] == 0) return {};
  const auto refuse = [&] {
    return failure(ErrorCode::kCorrupt, "{}: dataset {} cannot be read", where, name);
  };
  const Handle set(H5Dopen2(reader.file(), name, H5P_DEFAULT), H5Dclose);
  const Handle type(set ? H5Dget_type(set) : -1, H5Tclose);
  const Handle properties(set ? H5Dget_create_plist(set) : -1, H5Pclose);
  Shape chunk(2);
  if (!type || !properties || H5Tget_class(type) != H5T_INTEGER ||
      H5Tget_size(type) != sizeof(std::uint16_t) || H5Pget_layout(properties) != H5D_CHUNKED ||
      H5Pget_chunk(properties, 2, chunk.data()) != 2 || chunk[0] < 1 || chunk[1] != shape[1] ||
      chunk[0] > shape[0] || H5Pget_nfilters(properties) != 2) {
    return refuse();
  }
  const std::size_t chunks = (shape[0] + chunk[0] - 1) / chunk[0];
  const std::size_t numbers = chunk[0] * chunk[1];
  const std::size_t chunkBytes = numbers * sizeof(std::uint16_t);
  // Kept from chunk to chunk: fresh memory costs more than what is done in it.
  struct Worker {
    std::unique_ptr<libdeflate_decompressor, decltype(&libdeflate_free_decompressor)> inflater{
        libdeflate_alloc_decompressor(), libdeflate_free_decompressor};
    Bytes deflated;
    Bytes bytes;
  };
  tbb::enumerable_thread_specific<Worker> workers;
  std::mutex mutex;  // guards libhdf5
  std::atomic<bool> failed = false;
  tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t c) {
    Worker& worker = workers.local();
    if (!worker.inflater) throw std::bad_alloc();
    worker.bytes.resize(chunkBytes);
    {
      const std::scoped_lock lock(mutex);
      const hsize_t place[] = {c * chunk[0], 0};
      hsize_t bytes = 0;
      std::uint32_t filters = 0;
      if (failed || H5Dget_chunk_storage_size(set, place, &bytes) < 0 ||
          bytes > chunkBytes + chunkBytes / 8 + 64) {
        failed = true;
        return;
      }
      worker.deflated.resize(bytes);
      if (H5Dread_chunk(set, H5P_DEFAULT, place, &filters, worker.deflated.data()) < 0 ||
          filters != 0) {
        failed = true;
        return;
      }
    }
    // Without a place for the size: anything but chunkBytes fails.
    if (libdeflate_zlib_decompress(worker.inflater.get(), worker.deflated.data(),
                                   worker.deflated.size(), worker.bytes.data(), chunkBytes,
                                   nullptr) != LIBDEFLATE_SUCCESS) {
      failed = true;
      return;
    }
    const std::size_t first = c * chunk[0];
    for (std::size_t i = 0; i < std::min(chunk[0], shape[0] - first); ++i) {
      const std::byte* const lower = worker.bytes.data() + i * chunk[1];
      line(first + i, lower, lower + numbers);
    }
  });
  if (failed) return refuse();
  return {};
}

// The factors of a file of version 1: floats or halfs, row-major, V as in the paper, through
// shuffle and deflate.
Result<RowMajorMatrixf> matrixOfVersion1(Reader& reader, const char* name) {
  ASSIGN_OR_RETURN(const Shape extents, reader.shape(name, 2));
  const Handle set(H5Dopen2(reader.file(), name, H5P_DEFAULT), H5Dclose);
  const Handle type(H5Dget_type(set), H5Tclose);
  RowMajorMatrixf values(static_cast<Eigen::Index>(extents[0]),
                         static_cast<Eigen::Index>(extents[1]));
  if (H5Tget_size(type) == 2) {
    Eigen::Matrix<Eigen::half, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> halfs(
        values.rows(), values.cols());
    const Handle half(makeHalfType(), H5Tclose);
    RETURN_IF_ERROR(reader.values(name, half, halfs.data()));
    values = halfs.template cast<float>();
  } else {
    RETURN_IF_ERROR(reader.values(name, H5T_NATIVE_FLOAT, values.data()));
  }
  return values;
}

Result<void> readFactorsOfVersion1(Reader& reader, RelightableModel& model,
                                   const std::string& where) {
  Factors factors;
  factors.layout = model.layout;
  ASSIGN_OR_RETURN(factors.blockOffset,
                   reader.list<std::int64_t>("block_offset", H5T_NATIVE_INT64));
  ASSIGN_OR_RETURN(factors.E, matrixOfVersion1(reader, "E"));
  ASSIGN_OR_RETURN(factors.U, matrixOfVersion1(reader, "U"));
  ASSIGN_OR_RETURN(factors.V, matrixOfVersion1(reader, "V"));
  if (factors.blockOffset.empty() || factors.blockOffset.back() != factors.E.rows() ||
      factors.U.rows() != factors.E.rows() || factors.U.cols() != factors.V.rows() ||
      factors.E.cols() != model.layout.pixelsPerBlock() || !factors.E.allFinite() ||
      !factors.U.allFinite() || !factors.V.allFinite()) {
    return failure(ErrorCode::kCorrupt, "{}: its parts do not fit together", where);
  }
  const Handle set(H5Dopen2(reader.file(), "E", H5P_DEFAULT), H5Dclose);
  const Handle type(H5Dget_type(set), H5Tclose);
  setFactors(model, factors, H5Tget_size(type) == 2 ? Storage::kFloat16 : Storage::kFloat32);
  return {};
}

// E, U and V, which a plain file has given already.
Result<void> readFactors(Reader& reader, const Head& head, std::array<FactorValues, 3> plain,
                         RelightableModel& model, const std::string& where) {
  ASSIGN_OR_RETURN(const std::string storage, reader.text("storage"));
  bool known = false;
  for (const Storage each :
       {Storage::kFloat32, Storage::kFloat16, Storage::kQ8, Storage::kPacked}) {
    if (storage != nameOf(each)) continue;
    model.storage = each;
    known = true;
  }
  if (!known || head.places.has_value() == (model.storage == Storage::kPacked))
    return failure(ErrorCode::kUnsupported, "{}: storage '{}' is unknown", where, storage);
  ASSIGN_OR_RETURN(const auto ranks, reader.list<int>("block_rank", H5T_NATIVE_INT));
  model.blockOffset.reserve(ranks.size() + 1);
  model.blockOffset.push_back(0);
  for (const int rank : ranks) {
    if (rank < 0 || rank > model.layout.pixelsPerBlock())
      return failure(ErrorCode::kCorrupt, "{}: a block claims {} basis pictures", where, rank);
    model.blockOffset.push_back(model.blockOffset.back() + rank);
  }
  const bool packed = model.storage == Storage::kPacked;
  ASSIGN_OR_RETURN(const Shape e, reader.shape("E", 2));
  ASSIGN_OR_RETURN(const Shape u, reader.shape("U", packed ? 2 : 3));
  ASSIGN_OR_RETURN(const Shape v, reader.shape("V", 2));
  const hsize_t q = packed ? u[0] : u[1];
  if (q > hsize_t{1} << 20) return failure(ErrorCode::kCorrupt, "{}: its rank is {}", where, q);
  model.rank = static_cast<int>(q);
  const auto rows = static_cast<hsize_t>(model.rows());
  const auto columns = 3 * static_cast<hsize_t>(model.lights.size());
  const auto p = static_cast<hsize_t>(model.layout.pixelsPerBlock());
  const Shape wantedE = packed ? Shape{p, rows} : Shape{rows, p};
  const Shape wantedU = packed ? Shape{q, rows}
                               : Shape{static_cast<hsize_t>(model.panels()), q,
                                       hsize_t{RelightableModel::kPanelRows}};
  const Shape wantedV = packed ? Shape{3 * q, columns / 3} : Shape{columns, q};
  if (e != wantedE || u != wantedU || v != wantedV) {
    return failure(ErrorCode::kCorrupt, "{}: its parts do not fit together", where);
  }
  if (!packed) {
    const ElementType real =
        model.storage == Storage::kFloat32 ? ElementType::kFloat32 : ElementType::kFloat16;
    const ElementType basis = model.storage == Storage::kQ8 ? ElementType::kInt8 : real;
    if (plain[0].type() != basis || plain[1].type() != real || plain[2].type() != real)
      return failure(ErrorCode::kCorrupt, "{}: its numbers are not {}", where, storage);
    model.E = {std::move(plain[0]), {}};
    model.U = {std::move(plain[1]), {}};
    model.V = {std::move(plain[2]), {}};
    ASSIGN_OR_RETURN(model.E.scale, reader.scales("E_scale"));
    return {};
  }
  ASSIGN_OR_RETURN(const auto stepE, reader.scales("E_scale"));
  ASSIGN_OR_RETURN(auto stepU, reader.scales("U_scale"));
  ASSIGN_OR_RETURN(const auto stepV, reader.scales("V_scale"));
  if (stepE.size() != rows || stepU.size() != q || stepV.size() != q)
    return failure(ErrorCode::kCorrupt, "{}: its parts do not fit together", where);
  // Times what 16 bits and a DCT make of it a float must still hold it.
  for (const std::span<const float> steps :
       {std::span(stepE), std::span<const float>(stepU), std::span(stepV)}) {
    if (std::any_of(steps.begin(), steps.end(), [](float s) { return std::abs(s) > 1e30f; }))
      return failure(ErrorCode::kCorrupt, "{}: its scales are beyond all pictures", where);
  }
  Unpacker unpacker(model, model.lightCount());
  const auto to = [&](auto line) {
    return [&unpacker, line](std::size_t k, const std::byte* lower, const std::byte* upper) {
      (unpacker.*line)(k, lower, upper);
    };
  };
  RETURN_IF_ERROR(readPacked(reader, "E", wantedE, where, to(&Unpacker::lineOfE)));
  RETURN_IF_ERROR(readPacked(reader, "U", wantedU, where, to(&Unpacker::lineOfU)));
  RETURN_IF_ERROR(readPacked(reader, "V", wantedV, where, to(&Unpacker::lineOfV)));
  unpacker.finish(stepE, std::move(stepU), stepV);
  return {};
}

Result<RelightableModel> readContent(hid_t file, const std::filesystem::path& path,
                                     const Head& head, std::array<FactorValues, 3> plain) {
  // Deflate packs at most 1032 to 1.
  Reader reader(file, path, std::min<std::uint64_t>(head.fileBytes * 1100, std::uint64_t{1} << 38));
  const std::string where = path.string();
  RelightableModel model;
  ASSIGN_OR_RETURN(model.layout.width, reader.integer("width", 1, 1 << 20));
  ASSIGN_OR_RETURN(model.layout.height, reader.integer("height", 1, 1 << 20));
  ASSIGN_OR_RETURN(model.layout.blockSize, reader.integer("blockSize", 2, 64));
  constexpr std::int64_t kMostPixels = std::int64_t{1} << 31;
  if (std::int64_t{model.layout.width} * model.layout.height > kMostPixels) {
    return failure(ErrorCode::kCorrupt, "{}: a picture of {} x {} pixels", where,
                   model.layout.width, model.layout.height);
  }
  ASSIGN_OR_RETURN(model.lights, reader.directions("light_directions"));
  ASSIGN_OR_RETURN(model.solidAngles, reader.list<double>("solid_angles", H5T_NATIVE_DOUBLE));
  ASSIGN_OR_RETURN(model.capturedIds, reader.list<int>("captured_ids", H5T_NATIVE_INT));
  ASSIGN_OR_RETURN(model.capturedDirections, reader.directions("captured_directions"));
  ASSIGN_OR_RETURN(model.heldOutIds, reader.list<int>("held_out_ids", H5T_NATIVE_INT));
  if (head.version == 1) {
    RETURN_IF_ERROR(readFactorsOfVersion1(reader, model, where));
  } else {
    RETURN_IF_ERROR(readFactors(reader, head, std::move(plain), model, where));
  }
  if (head.version > 1) {
    ASSIGN_OR_RETURN(model.singleLamp, reader.integer("singleLamp", 0, 1));
  }
  if (const auto misfit = misfitOf(model))
    return failure(ErrorCode::kCorrupt, "{}: {}", where, *misfit);
  ASSIGN_OR_RETURN(const std::string interpolation, reader.text("interpolation"));
  ASSIGN_OR_RETURN(const Json settings, parseJson(interpolation, where + ": interpolation"));
  ASSIGN_OR_RETURN(model.interpolation, interpolationFrom(settings, where + ": interpolation"));
  ASSIGN_OR_RETURN(model.holdOutRule, reader.text("holdOutRule"));
  ASSIGN_OR_RETURN(model.sketch, reader.text("sketch"));
  ASSIGN_OR_RETURN(model.software, reader.text("software"));
  ASSIGN_OR_RETURN(const std::string notes, reader.text("notes"));
  ASSIGN_OR_RETURN(model.notes, parseJson(notes, where + ": notes"));
  return model;
}

// Version 1: one XXH3 of everything behind the user block.
Result<void> verifyVersion1(int fd, const Head& head, const std::filesystem::path& path) {
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(),
                                                                       XXH3_freeState);
  XXH3_64bits_reset(state.get());
  Bytes buffer(std::size_t{1} << 20);
  for (std::uint64_t at = kUserBlock; at < head.fileBytes;) {
    const std::uint64_t count = std::min<std::uint64_t>(buffer.size(), head.fileBytes - at);
    if (const int error = readAll(fd, buffer.data(), count, static_cast<std::int64_t>(at))) {
      return failure(ErrorCode::kIo, "{}: cannot read: {}", path.string(), systemMessage(error));
    }
    XXH3_64bits_update(state.get(), buffer.data(), count);
    at += count;
  }
  if (fmt::format("{:016x}", XXH3_64bits_digest(state.get())) != head.checksum) {
    return failure(ErrorCode::kCorrupt,
                   "{}: damaged or truncated: its content does not have the checksum it should",
                   path.string());
  }
  return {};
}

Result<RelightableModel> loadUnguarded(const std::filesystem::path& path) {
  const Descriptor descriptor(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!descriptor) {
    return failure(errno == ENOENT ? ErrorCode::kNotFound : ErrorCode::kIo, "{}: cannot open: {}",
                   path.string(), systemMessage(errno));
  }
  ASSIGN_OR_RETURN(const Head head, readHead(descriptor.get(), path));
  std::array<FactorValues, 3> factors;
  if (head.version == 1) {
    RETURN_IF_ERROR(verifyVersion1(descriptor.get(), head, path));
  } else {
    RETURN_IF_ERROR(readAndVerify(descriptor.get(), head, path, factors));
  }
  const std::scoped_lock lock(hdf5Mutex());
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  // By its descriptor: the very file that was verified, even if another has its name by now.
  const std::string opened = fmt::format("/proc/self/fd/{}", descriptor.get());
  const Handle file(H5Fopen(opened.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
  if (!file) return failure(ErrorCode::kCorrupt, "{}: libhdf5 cannot open it", path.string());
  return readContent(file, path, head, std::move(factors));
}

// Calls use(bytes of the whole file, its places); fails if libhdf5 does.
template <class Use>
Result<void> withFile(const RelightableModel& model, const std::string& where, Use use) {
  if (const auto misfit = misfitOf(model)) {
    return failure(ErrorCode::kInvalidArgument, "{}: {}", where, *misfit);
  }
  if (model.storage == Storage::kPacked && !model.code) {
    return failure(ErrorCode::kInvalidArgument, "{}: a packed model without its code", where);
  }
  const std::scoped_lock lock(hdf5Mutex());
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  try {
    if (buildFile(model, use)) return {};
  } catch (const std::bad_alloc&) {
  }
  return failure(ErrorCode::kIo, "{}: the file could not be built; is there memory enough?", where);
}

}  // namespace

Result<void> saveModel(const RelightableModel& model, const std::filesystem::path& path) {
  Result<void> written;
  RETURN_IF_ERROR(withFile(
      model, path.string(), [&](std::span<char> bytes, const std::optional<Places>& places) {
        const auto content = bytes.subspan(kUserBlock);
        std::vector<std::uint64_t> hashes((content.size() + kPiece - 1) / kPiece);
        tbb::parallel_for(std::size_t{0}, hashes.size(), [&](std::size_t k) {
          const auto piece = content.subspan(
              k * kPiece, std::min<std::size_t>(kPiece, content.size() - k * kPiece));
          hashes[k] = XXH3_64bits(piece.data(), piece.size());
        });
        const std::string line = placesLine(places);
        const std::string head = userBlock(checksumOf(hashes, line), line);
        std::copy(head.begin(), head.end(), bytes.begin());
        written = writeFileAtomically(path, std::string_view(bytes.data(), bytes.size()));
      }));
  return written;
}

Result<std::size_t> savedBytes(const RelightableModel& model) {
  std::size_t size = 0;
  RETURN_IF_ERROR(
      withFile(model, "model",
               [&](std::span<char> bytes, const std::optional<Places>&) { size = bytes.size(); }));
  return size;
}

Result<RelightableModel> loadModel(const std::filesystem::path& path) {
  try {
    return loadUnguarded(path);
  } catch (const std::bad_alloc&) {
    return failure(ErrorCode::kUnsupported, "{}: needs more memory than there is", path.string());
  }
}

}  // namespace lightsketch
