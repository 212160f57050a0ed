#include "pipeline/compress/model.h"

#include <fcntl.h>
#include <hdf5.h>
#include <unistd.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <mutex>
#include <new>
#include <span>
#include <string_view>
#include <utility>

#include "capture/frame/file.h"

namespace lightsketch {
namespace {

constexpr int kFormatVersion = 1;
constexpr const char* kFormat = "lightsketch-model";
// HDF5 leaves this many bytes at the file's start to us: one line of text, then zeros.
constexpr hsize_t kUserBlock = 1024;
constexpr const char* kReadMe =
    "E: rows x p, orthonormal rows per block; U: rows x q; V: q x 3n (column 3 i + c: light i, "
    "channel c). "
    "Rows block_offset[j] to block_offset[j+1] belong to block j, row-major over the picture, "
    "whose p pixels "
    "are row-major. Under intensities s (n x 3): v = V[:, c::3] s[:, c]; block j, channel c = "
    "E_j^T (U_j v). "
    "Linear RGB.";

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

// IEEE 754 half, which h5py knows as float16. Conversion is ours: libhdf5 1.10 loses the carry into
// the exponent when it rounds (0.24999 became 0.125).
hid_t makeHalfType() {
  const hid_t type = H5Tcopy(H5T_IEEE_F32LE);
  H5Tset_fields(type, 15, 10, 5, 0, 10);
  H5Tset_size(type, 2);
  H5Tset_ebias(type, 15);
  return type;
}

using HalfMatrix = Eigen::Matrix<Eigen::half, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
constexpr float kLargestHalf = 65504;

using Shape = std::vector<hsize_t>;

// Writes datasets and attributes; the first failure makes all that follows void.
class Writer {
 public:
  explicit Writer(hid_t file) : file_(file) {}
  bool ok() const { return ok_; }

  void dataset(const char* name, const Shape& shape, hid_t storedType, hid_t memoryType,
               const void* data) {
    const Handle space(H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr),
                       H5Sclose);
    const Handle properties(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
    // Chunks of about 256 KiB of rows; shuffle and deflate gain 10 to 20 percent on half floats.
    hsize_t rowBytes = H5Tget_size(storedType);
    for (std::size_t k = 1; k < shape.size(); ++k) rowBytes *= shape[k];
    if (*std::min_element(shape.begin(), shape.end()) > 0) {
      Shape chunk = shape;
      chunk[0] = std::clamp<hsize_t>((hsize_t{1} << 18) / rowBytes, 1, shape[0]);
      check(H5Pset_chunk(properties, static_cast<int>(chunk.size()), chunk.data()));
      check(H5Pset_shuffle(properties));
      check(H5Pset_deflate(properties, 1));
    }
    const Handle set(
        H5Dcreate2(file_, name, storedType, space, H5P_DEFAULT, properties, H5P_DEFAULT), H5Dclose);
    check(set);
    if (ok_) check(H5Dwrite(set, memoryType, H5S_ALL, H5S_ALL, H5P_DEFAULT, data));
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
  bool ok_ = true;
};

// XXH3 of everything after the user block.
Result<std::string> checksumBehindUserBlock(int fd, const std::filesystem::path& path) {
  std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(),
                                                                 XXH3_freeState);
  XXH3_64bits_reset(state.get());
  std::vector<char> buffer(std::size_t{1} << 20);
  off_t at = kUserBlock;
  for (;;) {
    const ssize_t count = ::pread(fd, buffer.data(), buffer.size(), at);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) {
      return failure(ErrorCode::kIo, "{}: cannot read: {}", path.string(), systemMessage(errno));
    }
    if (count == 0) break;
    XXH3_64bits_update(state.get(), buffer.data(), static_cast<std::size_t>(count));
    at += count;
  }
  return fmt::format("{:016x}", XXH3_64bits_digest(state.get()));
}

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }

 private:
  int fd_;
};

// Reads datasets and attributes, checked for shape before anything is allocated.
class Reader {
 public:
  Reader(hid_t file, const std::filesystem::path& path, std::uint64_t maxBytes)
      : file_(file), where_(path.string()), maxBytes_(maxBytes) {}

  Result<Shape> shape(const char* name, int dimensions) {
    const Handle set(H5Dopen2(file_, name, H5P_DEFAULT), H5Dclose);
    if (!set) return failure(ErrorCode::kCorrupt, "{}: dataset {} is missing", where_, name);
    const Handle space(H5Dget_space(set), H5Sclose);
    if (H5Sget_simple_extent_ndims(space) != dimensions) {
      return failure(ErrorCode::kCorrupt, "{}: dataset {} does not have {} dimensions", where_,
                     name, dimensions);
    }
    Shape shape(static_cast<std::size_t>(dimensions));
    H5Sget_simple_extent_dims(space, shape.data(), nullptr);
    std::uint64_t bytes = 8;
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

  Result<RowMajorMatrixf> matrix(const char* name) {
    ASSIGN_OR_RETURN(const Shape extents, shape(name, 2));
    RowMajorMatrixf values2d(static_cast<Eigen::Index>(extents[0]),
                             static_cast<Eigen::Index>(extents[1]));
    if (storage(name) == Storage::kFloat16) {
      const Handle half(makeHalfType(), H5Tclose);
      HalfMatrix halfs(values2d.rows(), values2d.cols());
      RETURN_IF_ERROR(values(name, half, halfs.data()));
      values2d = halfs.cast<float>();
    } else {
      RETURN_IF_ERROR(values(name, H5T_NATIVE_FLOAT, values2d.data()));
    }
    if (!values2d.allFinite())
      return failure(ErrorCode::kCorrupt, "{}: dataset {} is not finite", where_, name);
    return values2d;
  }

  Storage storage(const char* name) {
    const Handle set(H5Dopen2(file_, name, H5P_DEFAULT), H5Dclose);
    const Handle type(H5Dget_type(set), H5Tclose);
    return H5Tget_size(type) == 2 ? Storage::kFloat16 : Storage::kFloat32;
  }

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
    for (const auto& d : result) {
      if (!(std::abs(d.norm() - 1) < 1e-6)) {
        return failure(ErrorCode::kCorrupt,
                       "{}: dataset {} holds a direction that is not of unit length", where_, name);
      }
    }
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

constexpr const char* kKernelNames[] = {"thinPlate", "linear", "cubic"};

Json toJson(const InterpolationSettings& settings) {
  return {{"kernel", kKernelNames[static_cast<int>(settings.kernel)]},
          {"trendDegree", settings.trendDegree},
          {"nugget", settings.nugget},
          {"outsideClamp", settings.outsideClamp}};
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
  return settings;
}

// The whole HDF5 file, built in memory: libhdf5 1.10 crashes when a disk fills up under it. Calls
// use(bytes) with a zeroed user block in front. False if libhdf5 failed.
template <class Use>
bool buildFile(const RelightableModel& model, Use use) {
  const Factors factors = factorsOf(model);
  const Handle creation(H5Pcreate(H5P_FILE_CREATE), H5Pclose);
  H5Pset_userblock(creation, kUserBlock);
  const Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
  constexpr std::size_t kIncrement = std::size_t{1} << 24;
  H5Pset_fapl_core(access, kIncrement, false);
  const Handle file(H5Fcreate("model in memory", H5F_ACC_TRUNC, creation, access), H5Fclose);
  if (!file) return false;
  Writer writer(file);
  const Handle half(makeHalfType(), H5Tclose);
  const auto matrix = [&](const char* name, const RowMajorMatrixf& values) {
    const Shape shape{static_cast<hsize_t>(values.rows()), static_cast<hsize_t>(values.cols())};
    if (model.storage == Storage::kFloat16) {
      const HalfMatrix halfs =
          values.cwiseMax(-kLargestHalf).cwiseMin(kLargestHalf).cast<Eigen::half>();
      writer.dataset(name, shape, half, half, halfs.data());
    } else {
      writer.dataset(name, shape, H5T_IEEE_F32LE, H5T_NATIVE_FLOAT, values.data());
    }
  };
  const auto integers = [&](const char* name, const std::vector<int>& values) {
    writer.dataset(name, {values.size()}, H5T_STD_I32LE, H5T_NATIVE_INT, values.data());
  };
  const auto directions = [&](const char* name, const std::vector<Eigen::Vector3d>& values) {
    static_assert(sizeof(Eigen::Vector3d) == 3 * sizeof(double));
    writer.dataset(name, {values.size(), 3}, H5T_IEEE_F64LE, H5T_NATIVE_DOUBLE, values.data());
  };
  matrix("E", factors.E);
  matrix("U", factors.U);
  matrix("V", factors.V);
  writer.dataset("block_offset", {model.blockOffset.size()}, H5T_STD_I64LE, H5T_NATIVE_INT64,
                 model.blockOffset.data());
  directions("light_directions", model.lights);
  writer.dataset("solid_angles", {model.solidAngles.size()}, H5T_IEEE_F64LE, H5T_NATIVE_DOUBLE,
                 model.solidAngles.data());
  integers("captured_ids", model.capturedIds);
  directions("captured_directions", model.capturedDirections);
  integers("held_out_ids", model.heldOutIds);
  writer.text("format", kFormat);
  writer.integer("formatVersion", kFormatVersion);
  writer.text("readme", kReadMe);
  writer.integer("width", model.layout.width);
  writer.integer("height", model.layout.height);
  writer.integer("blockSize", model.layout.blockSize);
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
                kUserBlock + static_cast<std::size_t>(image)));
  return true;
}

std::string userBlockLine(const std::string& checksum) {
  return fmt::format("{} {} xxh3 {}\n", kFormat, kFormatVersion, checksum);
}

// Refuses other files, newer versions and damage, before libhdf5 sees the file. Returns its size.
Result<std::uint64_t> verifyUserBlock(const std::filesystem::path& path) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) {
    return failure(errno == ENOENT ? ErrorCode::kNotFound : ErrorCode::kIo, "{}: cannot open: {}",
                   path.string(), systemMessage(errno));
  }
  std::array<char, kUserBlock> block{};
  const ssize_t count = ::pread(file.get(), block.data(), block.size() - 1, 0);
  if (count < 0) {
    return failure(ErrorCode::kIo, "{}: cannot read: {}", path.string(), systemMessage(errno));
  }
  int version = 0;
  char found[17] = {};
  const int fields =
      std::sscanf(block.data(), "lightsketch-model %d xxh3 %16[0-9a-f]", &version, found);
  if (fields < 1) {
    return failure(ErrorCode::kCorrupt, "{}: not a lightsketch model, or its beginning is damaged",
                   path.string());
  }
  if (version > kFormatVersion) {
    return failure(
        ErrorCode::kUnsupported,
        "{}: format version {} is newer than {}, the newest that this program reads; update it",
        path.string(), version, kFormatVersion);
  }
  ASSIGN_OR_RETURN(const std::string actual, checksumBehindUserBlock(file.get(), path));
  if (fields != 2 || version < 1 || userBlockLine(actual) != std::string(block.data())) {
    return failure(ErrorCode::kCorrupt,
                   "{}: damaged or truncated: its content does not have the checksum it should",
                   path.string());
  }
  const off_t size = ::lseek(file.get(), 0, SEEK_END);
  return static_cast<std::uint64_t>(std::max<off_t>(size, 0));
}

Result<RelightableModel> readContent(hid_t file, const std::filesystem::path& path,
                                     std::uint64_t fileBytes) {
  // Deflate packs at most 1032 to 1.
  Reader reader(file, path, std::min<std::uint64_t>(fileBytes * 1100, std::uint64_t{1} << 38));
  RelightableModel model;
  ASSIGN_OR_RETURN(model.layout.width, reader.integer("width", 1, 1 << 20));
  ASSIGN_OR_RETURN(model.layout.height, reader.integer("height", 1, 1 << 20));
  ASSIGN_OR_RETURN(model.layout.blockSize, reader.integer("blockSize", 1, 1024));
  // All shapes first, then the data.
  ASSIGN_OR_RETURN(const Shape e, reader.shape("E", 2));
  ASSIGN_OR_RETURN(const Shape u, reader.shape("U", 2));
  ASSIGN_OR_RETURN(const Shape v, reader.shape("V", 2));
  ASSIGN_OR_RETURN(const Shape lights, reader.shape("light_directions", 2));
  ASSIGN_OR_RETURN(const Shape offsets, reader.shape("block_offset", 1));
  const double blocks =
      std::ceil(static_cast<double>(model.layout.width) / model.layout.blockSize) *
      std::ceil(static_cast<double>(model.layout.height) / model.layout.blockSize);
  if (static_cast<double>(offsets[0]) != blocks + 1 || e[0] != u[0] || u[1] != v[0] ||
      v[1] != 3 * lights[0] || e[1] != static_cast<hsize_t>(model.layout.pixelsPerBlock())) {
    return failure(ErrorCode::kCorrupt, "{}: its parts do not fit together", path.string());
  }
  Factors factors;
  factors.layout = model.layout;
  ASSIGN_OR_RETURN(factors.E, reader.matrix("E"));
  ASSIGN_OR_RETURN(factors.U, reader.matrix("U"));
  ASSIGN_OR_RETURN(factors.V, reader.matrix("V"));
  ASSIGN_OR_RETURN(factors.blockOffset,
                   reader.list<std::int64_t>("block_offset", H5T_NATIVE_INT64));
  if (factors.blockOffset.back() != factors.E.rows())
    return failure(ErrorCode::kCorrupt, "{}: its parts do not fit together", path.string());
  setFactors(model, factors, reader.storage("E"));
  ASSIGN_OR_RETURN(model.lights, reader.directions("light_directions"));
  ASSIGN_OR_RETURN(model.solidAngles, reader.list<double>("solid_angles", H5T_NATIVE_DOUBLE));
  ASSIGN_OR_RETURN(model.capturedIds, reader.list<int>("captured_ids", H5T_NATIVE_INT));
  ASSIGN_OR_RETURN(model.capturedDirections, reader.directions("captured_directions"));
  ASSIGN_OR_RETURN(model.heldOutIds, reader.list<int>("held_out_ids", H5T_NATIVE_INT));
  if (const auto misfit = misfitOf(model))
    return failure(ErrorCode::kCorrupt, "{}: {}", path.string(), *misfit);
  ASSIGN_OR_RETURN(const std::string interpolation, reader.text("interpolation"));
  ASSIGN_OR_RETURN(const Json settings,
                   parseJson(interpolation, path.string() + ": interpolation"));
  ASSIGN_OR_RETURN(model.interpolation,
                   interpolationFrom(settings, path.string() + ": interpolation"));
  ASSIGN_OR_RETURN(model.holdOutRule, reader.text("holdOutRule"));
  ASSIGN_OR_RETURN(model.sketch, reader.text("sketch"));
  ASSIGN_OR_RETURN(model.software, reader.text("software"));
  ASSIGN_OR_RETURN(const std::string notes, reader.text("notes"));
  ASSIGN_OR_RETURN(model.notes, parseJson(notes, path.string() + ": notes"));
  return model;
}

}  // namespace

Result<void> saveModel(const RelightableModel& model, const std::filesystem::path& path) {
  if (const auto misfit = misfitOf(model)) {
    return failure(ErrorCode::kInvalidArgument, "{}: {}", path.string(), *misfit);
  }
  const std::scoped_lock lock(hdf5Mutex());
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  Result<void> written;
  const auto write = [&](std::span<char> bytes) {
    const auto content = bytes.subspan(kUserBlock);
    const std::string line =
        userBlockLine(fmt::format("{:016x}", XXH3_64bits(content.data(), content.size())));
    std::copy(line.begin(), line.end(), bytes.begin());
    written = writeFileAtomically(path, std::string_view(bytes.data(), bytes.size()));
  };
  if (!buildFile(model, write)) {
    return failure(ErrorCode::kIo, "{}: libhdf5 could not build the model; is there memory enough?",
                   path.string());
  }
  return written;
}

Result<RelightableModel> loadModel(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::uint64_t size, verifyUserBlock(path));
  const std::scoped_lock lock(hdf5Mutex());
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  const Handle file(H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
  if (!file) return failure(ErrorCode::kCorrupt, "{}: libhdf5 cannot open it", path.string());
  try {
    return readContent(file, path, size);
  } catch (const std::bad_alloc&) {
    return failure(ErrorCode::kUnsupported, "{}: needs more memory than there is", path.string());
  }
}

}  // namespace lightsketch
