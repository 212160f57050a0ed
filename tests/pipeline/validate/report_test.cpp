#include "pipeline/validate/report.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <limits>
#include <regex>
#include <set>

#include "capture/frame/file.h"
#include "capture/frame/json.h"
#include "pipeline/validate/metrics.h"
#include "synthetic.h"

namespace lightsketch {
namespace {

using testing::exactModel;
using testing::makeSketch;
using testing::mattePicture;
using testing::TemporaryFolder;

int countOf(const std::string& text, const std::string& part) {
  int count = 0;
  for (auto at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++count;
  return count;
}

class Report : public ::testing::Test {
 protected:
  static constexpr const char* kHostile = "<script>alert('x')</script>&\"";

  void SetUp() override {
    const Sketch sketch = makeSketch(folder_.path() / "a<b>\"c", mattePicture, 24, kHostile);
    RelightableModel model = exactModel(sketch, mattePicture, "every:8:4");
    testing::scale(model, 1.02f);  // so that something differs
    model.software = "<img src=x onerror=alert(1)>";
    SilentProgress progress;
    ValidateOptions options;
    options.pictures = 2;
    options.environment = analyticSky();
    options.environmentName = "</code><b>sky";
    auto report = validate(sketch, model, options, progress);
    ASSERT_TRUE(report) << report.error().message;
    report_ = std::move(*report);
  }

  std::string write() {
    const auto written = writeReport(report_, out());
    EXPECT_TRUE(written) << written.error().message;
    return readFile(out() / "index.html").value();
  }
  std::filesystem::path out() const { return folder_.path() / "report"; }

  TemporaryFolder folder_;
  ValidationReport report_;
};

TEST_F(Report, HoldsEveryLightAndItsPictures) {
  const std::string page = write();
  for (const HeldOutLight& light : report_.lights) {
    EXPECT_EQ(countOf(page, fmt::format("<tr id=\"light-{}\"", light.id)), 1);
  }
  for (const ShownLight& shown : report_.shown) {
    const int id = report_.lights[shown.light].id;
    EXPECT_EQ(countOf(page, fmt::format("id=\"pictures-{}\"", id)), 1);
  }
  EXPECT_EQ(countOf(page, "<img"), 3 * static_cast<int>(report_.shown.size()) + 3);
  EXPECT_EQ(countOf(page, "class=\"dot\""), static_cast<int>(report_.lights.size()) + 1);  // legend
}

TEST_F(Report, EveryLinkHasItsTarget) {
  const std::string page = write();
  static const std::regex link("href=\"#([^\"]*)\"");
  int links = 0;
  for (auto at = std::sregex_iterator(page.begin(), page.end(), link); at != std::sregex_iterator();
       ++at, ++links) {
    EXPECT_EQ(countOf(page, fmt::format("id=\"{}\"", (*at)[1].str())), 1) << (*at)[1];
  }
  EXPECT_GE(links, static_cast<int>(report_.lights.size()));
  EXPECT_EQ(countOf(page, "href="), links);  // no link leads out
}

TEST_F(Report, NeedsNothingFromOutside) {
  const std::string page = write();
  EXPECT_EQ(countOf(page, "http:") + countOf(page, "https:"), 0);
  EXPECT_EQ(countOf(page, "<link"), 0);
  EXPECT_EQ(countOf(page, "@import"), 0);
  EXPECT_EQ(countOf(page, "url("), countOf(page, "url(#"));
  EXPECT_EQ(countOf(page, " src="),
            countOf(page, " src=\"data:image/png;base64,") + countOf(page, "&lt;img src=x"));
}

TEST_F(Report, EmbedsWholePngFiles) {
  const std::string page = write();
  static const std::string digits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  const std::string prefix = "base64,";
  for (auto at = page.find(prefix); at != std::string::npos; at = page.find(prefix, at + 1)) {
    std::string png;
    unsigned word = 0;
    int bits = 0;
    for (std::size_t i = at + prefix.size(); page[i] != '"' && page[i] != '='; ++i) {
      word = word << 6 | static_cast<unsigned>(digits.find(page[i]));
      bits += 6;
      if (bits >= 8) {
        bits -= 8;
        png += static_cast<char>(word >> bits & 255);
      }
    }
    EXPECT_EQ(png.substr(0, 8), "\x89PNG\r\n\x1a\n");
    EXPECT_EQ(png.substr(png.size() - 8), "IEND\xae\x42\x60\x82");  // with its checksum
  }
}

TEST_F(Report, EscapesWhatComesFromFiles) {
  const std::string page = write();
  EXPECT_EQ(countOf(page, "<script>"), 1);  // its own
  EXPECT_EQ(countOf(page, "alert('x')"), 0);
  EXPECT_EQ(countOf(page, "<img src=x"), 0);
  EXPECT_EQ(countOf(page, "</code><b>"), 0);
  EXPECT_EQ(countOf(page, "a<b>"), 0);
  EXPECT_EQ(countOf(page, "<note>"), 0);
  EXPECT_GT(countOf(page, "&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt;&amp;&quot;"), 0);
  EXPECT_GT(countOf(page, "a &lt;note&gt;"), 0);
}

TEST_F(Report, TagsAreBalanced) {
  std::string page = write();
  page = page.substr(page.find("<body>"));
  page = page.substr(0, page.find("<script>"));
  for (const char* tag : {"div", "section", "table", "tbody", "thead", "tr", "td", "th", "figure",
                          "figcaption", "span", "p", "a", "svg", "code", "strong"}) {
    const std::regex open(fmt::format("<{}[ >]", tag));
    const auto opened = std::distance(std::sregex_iterator(page.begin(), page.end(), open), {});
    EXPECT_EQ(opened, countOf(page, fmt::format("</{}>", tag))) << tag;
  }
}

TEST_F(Report, JsonAndCsvHoldEveryFigure) {
  report_.lights[1].error.relative = std::numeric_limits<double>::infinity();
  report_.lights[1].error.ssim.reset();
  write();
  const auto json = readJsonFile(out() / "report.json");
  ASSERT_TRUE(json) << json.error().message;
  EXPECT_TRUE(checkFormat(*json, "lightsketch-validation", 1, "report.json"));
  ASSERT_EQ((*json)["lights"].size(), report_.lights.size());
  EXPECT_EQ((*json)["mean"]["psnrDb"], report_.all.psnr);
  EXPECT_EQ((*json)["lights"][0]["psnrDb"], report_.lights[0].error.psnr);
  EXPECT_EQ((*json)["lights"][0]["origin"], report_.lights[0].origin);
  EXPECT_TRUE((*json)["lights"][1]["relativeError"].is_null());
  EXPECT_TRUE((*json)["lights"][1]["ssim"].is_null());
  EXPECT_EQ((*json)["superposition"]["environment"], "</code><b>sky");

  const std::string csv = readFile(out() / "lights.csv").value();
  EXPECT_EQ(countOf(csv, "\n"), 1 + static_cast<int>(report_.lights.size()));
  EXPECT_NE(csv.find("&\"\"4.png\""), std::string::npos);  // quotes doubled
}

TEST_F(Report, ReplacesAnOlderOneAndLeavesNothingElse) {
  write();
  report_.all.psnr = 12.34;
  EXPECT_NE(write().find("12.34"), std::string::npos);
  std::set<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(out())) {
    names.insert(entry.path().filename().string());
  }
  EXPECT_EQ(names, (std::set<std::string>{"index.html", "lights.csv", "report.json"}));
}

TEST_F(Report, SaysWhereItCannotWrite) {
  const auto file = folder_.path() / "file";
  std::ofstream(file) << "x";
  const auto written = writeReport(report_, file / "report");
  ASSERT_FALSE(written);
  EXPECT_NE(written.error().message.find("file/report"), std::string::npos)
      << written.error().message;
}

}  // namespace
}  // namespace lightsketch
