#include "capture/frame/json.h"

#include <cmath>

#include "capture/frame/file.h"

namespace lightsketch {
namespace {

// Deep nesting would exhaust the parser's stack; no file of ours nests deeper than six.
bool nestsDeeperThan(std::string_view text, int limit) {
  int depth = 0;
  bool inString = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (inString) {
      if (c == '\\')
        ++i;
      else if (c == '"')
        inString = false;
    } else if (c == '"') {
      inString = true;
    } else if (c == '{' || c == '[') {
      if (++depth > limit) return true;
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return false;
}

}  // namespace

Result<Json> parseJson(std::string_view text, std::string_view where) {
  if (nestsDeeperThan(text, 64)) {
    return failure(ErrorCode::kCorrupt, "{}: nested too deeply to be a file of ours", where);
  }
  try {
    return Json::parse(text);
  } catch (const Json::exception& error) {
    return failure(ErrorCode::kCorrupt, "{}: damaged or not JSON ({})", where, error.what());
  }
}

Result<Json> readJsonFile(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const auto text, readFile(path, std::uint64_t{64} << 20));
  return parseJson(text, path.string());
}

Result<void> writeJsonFile(const std::filesystem::path& path, const Json& value) {
  return writeFileAtomically(path,
                             value.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

Result<const Json*> jsonMember(const Json& object, std::string_view field, std::string_view where) {
  if (!object.is_object()) {
    return failure(ErrorCode::kCorrupt, "{}: expected an object with field '{}'", where, field);
  }
  const auto found = object.find(field);
  if (found == object.end()) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' is missing", where, field);
  }
  return &*found;
}

Result<bool> jsonBool(const Json& object, std::string_view field, std::string_view where) {
  ASSIGN_OR_RETURN(const Json* value, jsonMember(object, field, where));
  if (!value->is_boolean()) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' is neither true nor false", where, field);
  }
  return value->get<bool>();
}

Result<double> jsonNumber(const Json& object, std::string_view field, std::string_view where) {
  ASSIGN_OR_RETURN(const Json* value, jsonMember(object, field, where));
  if (!value->is_number() || !std::isfinite(value->get<double>())) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' is not a number", where, field);
  }
  return value->get<double>();
}

Result<std::int64_t> jsonInteger(const Json& object, std::string_view field, std::string_view where,
                                 std::int64_t min, std::int64_t max) {
  ASSIGN_OR_RETURN(const Json* value, jsonMember(object, field, where));
  if (!value->is_number_integer()) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' is not a whole number", where, field);
  }
  const bool tooLarge = value->is_number_unsigned() &&
                        value->get<std::uint64_t>() > static_cast<std::uint64_t>(INT64_MAX);
  const std::int64_t number = tooLarge ? INT64_MAX : value->get<std::int64_t>();
  if (tooLarge || number < min || number > max) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' is outside {}..{}", where, field, min, max);
  }
  return number;
}

Result<std::string> jsonString(const Json& object, std::string_view field, std::string_view where) {
  ASSIGN_OR_RETURN(const Json* value, jsonMember(object, field, where));
  if (!value->is_string()) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' is not a string", where, field);
  }
  return value->get<std::string>();
}

Result<Eigen::VectorXd> jsonVector(const Json& object, std::string_view field, int size,
                                   std::string_view where) {
  ASSIGN_OR_RETURN(const Json* value, jsonMember(object, field, where));
  const auto refuse = [&] {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' is not an array of {} numbers", where,
                   field, size);
  };
  if (!value->is_array() || value->size() != static_cast<std::size_t>(size)) return refuse();
  Eigen::VectorXd vector(size);
  for (int i = 0; i < size; ++i) {
    const Json& element = (*value)[static_cast<std::size_t>(i)];
    if (!element.is_number() || !std::isfinite(element.get<double>())) return refuse();
    vector[i] = element.get<double>();
  }
  return vector;
}

Json toJson(const Eigen::VectorXd& vector) {
  Json array = Json::array();
  for (const double value : vector) array.push_back(value);
  return array;
}

Result<int> checkFormat(const Json& object, std::string_view format, int newestVersion,
                        std::string_view where) {
  ASSIGN_OR_RETURN(const auto kind, jsonString(object, "format", where));
  if (kind != format) {
    return failure(ErrorCode::kCorrupt, "{}: is a '{}', expected a '{}'", where, kind, format);
  }
  ASSIGN_OR_RETURN(const auto version, jsonInteger(object, "formatVersion", where, 1, 1'000'000));
  if (version > newestVersion) {
    return failure(
        ErrorCode::kUnsupported,
        "{}: written by a newer lightsketch (format version {}, this one reads up to {}); "
        "update lightsketch",
        where, version, newestVersion);
  }
  return static_cast<int>(version);
}

}  // namespace lightsketch
