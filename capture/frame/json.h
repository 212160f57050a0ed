// Reading JSON that may be damaged or hostile: every failure names the file and the field.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "capture/frame/result.h"

namespace lightsketch {

using Json = nlohmann::json;

// `where` is the file (and line) for messages. Nesting is bounded; never throws.
Result<Json> parseJson(std::string_view text, std::string_view where);
Result<Json> readJsonFile(const std::filesystem::path& path);
// Pretty-printed, written atomically, with a final newline.
Result<void> writeJsonFile(const std::filesystem::path& path, const Json& value);

// Field access that says file and field when it is absent or of another type.
Result<const Json*> jsonMember(const Json& object, std::string_view field, std::string_view where);
Result<bool> jsonBool(const Json& object, std::string_view field, std::string_view where);
Result<double> jsonNumber(const Json& object, std::string_view field, std::string_view where);
Result<std::int64_t> jsonInteger(const Json& object, std::string_view field, std::string_view where,
                                 std::int64_t min, std::int64_t max);
Result<std::string> jsonString(const Json& object, std::string_view field, std::string_view where);
// An array of exactly `size` finite numbers.
Result<Eigen::VectorXd> jsonVector(const Json& object, std::string_view field, int size,
                                   std::string_view where);
Json toJson(const Eigen::VectorXd& vector);

// Every file of ours carries "format" (its kind) and "formatVersion". Refuses another kind and a
// newer version in words; returns the version.
Result<int> checkFormat(const Json& object, std::string_view format, int newestVersion,
                        std::string_view where);

}  // namespace lightsketch
