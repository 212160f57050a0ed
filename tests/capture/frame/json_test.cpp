#include "capture/frame/json.h"

#include <gtest/gtest.h>

#include <limits>

#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

template <class T>
void expectComplaint(const Result<T>& result, const std::string& field) {
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(result.error().message.rfind("f.json", 0), 0u) << result.error().message;
  EXPECT_NE(result.error().message.find("'" + field + "'"), std::string::npos)
      << result.error().message;
}

TEST(Json, ReadsFields) {
  const Json json = {{"n", 2.5}, {"i", -3}, {"s", "x"}, {"b", true}, {"v", {1, 2.5, 3}}};
  EXPECT_EQ(jsonNumber(json, "n", "f").value(), 2.5);
  EXPECT_EQ(jsonInteger(json, "i", "f", -3, 3).value(), -3);
  EXPECT_EQ(jsonString(json, "s", "f").value(), "x");
  EXPECT_TRUE(jsonBool(json, "b", "f").value());
  EXPECT_EQ(jsonVector(json, "v", 3, "f").value(), Eigen::Vector3d(1, 2.5, 3));
}

TEST(Json, NamesFileAndFieldWhereOneIsAbsentOrWrong) {
  const Json json = {{"text", "x"}, {"number", 1.5}, {"list", {1, "x"}}, {"large", 1ULL << 63}};
  expectComplaint(jsonNumber(json, "absent", "f.json"), "absent");
  expectComplaint(jsonNumber(json, "text", "f.json"), "text");
  expectComplaint(jsonInteger(json, "number", "f.json", 0, 10), "number");
  expectComplaint(jsonInteger(json, "large", "f.json", 0, INT64_MAX - 1), "large");
  expectComplaint(jsonString(json, "number", "f.json"), "number");
  expectComplaint(jsonBool(json, "number", "f.json"), "number");
  expectComplaint(jsonVector(json, "list", 2, "f.json"), "list");
  expectComplaint(jsonVector(json, "list", 3, "f.json"), "list");
  expectComplaint(jsonMember(Json::array(), "a", "f.json"), "a");
}

TEST(Json, DamagedTextIsAnErrorNotAnException) {
  for (const std::string text :
       {"", "{", "{\"a\":}", "nul", "{\"a\":1e999}", "\"\xff\"", "[1,2", "{} {}"}) {
    const auto result = parseJson(text, "f.json");
    ASSERT_FALSE(result) << text;
    EXPECT_EQ(result.error().message.rfind("f.json: ", 0), 0u);
    EXPECT_EQ(result.error().message.find('\n'), std::string::npos);
  }
}

TEST(Json, RefusesNestingThatWouldExhaustTheStack) {
  EXPECT_FALSE(parseJson(std::string(1'000'000, '['), "f.json"));
  EXPECT_TRUE(parseJson("\"" + std::string(1000, '[') + "\"", "f.json"));
}

TEST(Json, FileRoundTrip) {
  const TemporaryFolder folder;
  const Json json = {{"a", {1.0 / 3, -1e-300}}, {"s", "\xC3\xA4\n"}};
  ASSERT_TRUE(writeJsonFile(folder / "a.json", json));
  EXPECT_EQ(readJsonFile(folder / "a.json").value(), json);
  EXPECT_EQ(contentOf(folder / "a.json").back(), '\n');
}

TEST(CheckFormat, RefusesAnotherKindAndANewerVersionInWords) {
  EXPECT_EQ(checkFormat({{"format", "x"}, {"formatVersion", 2}}, "x", 3, "f").value(), 2);
  EXPECT_EQ(checkFormat({{"format", "y"}, {"formatVersion", 2}}, "x", 3, "f").error().code,
            ErrorCode::kCorrupt);
  const auto newer = checkFormat({{"format", "x"}, {"formatVersion", 4}}, "x", 3, "f");
  EXPECT_EQ(newer.error().code, ErrorCode::kUnsupported);
  EXPECT_NE(newer.error().message.find("newer"), std::string::npos);
  EXPECT_FALSE(checkFormat({{"format", "x"}, {"formatVersion", 0}}, "x", 3, "f"));
  EXPECT_FALSE(checkFormat({{"format", "x"}, {"formatVersion", 1.5}}, "x", 3, "f"));
  EXPECT_FALSE(checkFormat(Json(), "x", 3, "f"));
}

}  // namespace
}  // namespace lightsketch
