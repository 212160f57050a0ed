#include "pipeline/sketch/lp.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <string_view>

#include "capture/frame/file.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMaxListBytes = std::uint64_t{64} << 20;
constexpr std::size_t kMaxLights = 1'000'000;
constexpr double kUnitTolerance = 1e-3;  // three written digits are as good as unit length

struct Line {
  int number;
  std::string_view text;  // trimmed, not empty
};

std::string_view trim(std::string_view text) {
  constexpr std::string_view kBlank = " \t\r\v\f";
  const auto first = text.find_first_not_of(kBlank);
  if (first == text.npos) return {};
  return text.substr(first, text.find_last_not_of(kBlank) - first + 1);
}

// Lines that are not blank; takes care of a byte-order mark and of CR LF.
std::vector<Line> linesOf(std::string_view text) {
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  std::vector<Line> lines;
  for (int number = 1; !text.empty(); ++number) {
    const auto end = std::min(text.find('\n'), text.size());
    const auto line = trim(text.substr(0, end));
    if (!line.empty()) lines.push_back({number, line});
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return lines;
}

std::string_view takeLastToken(std::string_view& text) {
  const auto start = text.find_last_of(" \t");
  const auto token = start == text.npos ? text : text.substr(start + 1);
  text = start == text.npos ? std::string_view() : trim(text.substr(0, start));
  return token;
}

// A quoted piece of a hostile file must not turn one message into many lines.
std::string quote(std::string_view token) {
  std::string text(token.substr(0, 40));
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  }
  return text;
}

Result<double> parseNumber(std::string_view token, const std::string& where) {
  const std::string_view digits = token.starts_with('+') ? token.substr(1) : token;
  double value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (error != std::errc() || end != digits.data() + digits.size() || !std::isfinite(value)) {
    return failure(ErrorCode::kCorrupt, "{}: not a number: '{}'", where, quote(token));
  }
  return value;
}

std::string at(const fs::path& file, int line) {
  return fmt::format("{}: line {}", file.string(), line);
}

// Gathers vectors that are not of unit length for one warning.
class UnitLengthCheck {
 public:
  Result<Eigen::Vector3d> normalise(const Eigen::Vector3d& vector, const std::string& where) {
    const double length = vector.norm();
    if (!(length > 1e-6 && std::isfinite(length))) {
      return failure(ErrorCode::kCorrupt, "{}: the light direction has length {}; expected 1",
                     where, length);
    }
    if (std::abs(length - 1) > kUnitTolerance) {
      ++count_;
      if (std::abs(length - 1) > std::abs(worst_ - 1)) worst_ = length;
    }
    return Eigen::Vector3d(vector / length);
  }
  void report(const fs::path& file, Progress& progress) const {
    if (count_ == 0) return;
    progress.warn(
        fmt::format("{}: {} light direction{} not of unit length (the worst has {:.4g}); "
                    "normalised",
                    file.string(), count_, count_ == 1 ? " is" : "s are", worst_));
  }

 private:
  int count_ = 0;
  double worst_ = 1;
};

// A line of a list before anybody looked whether its image exists.
struct Listed {
  int line;
  std::string name;
  Eigen::Vector3d direction;
};

Result<std::vector<Listed>> parseLp(const fs::path& file, Progress& progress) {
  ASSIGN_OR_RETURN(const auto text, readFile(file, kMaxListBytes));
  const auto lines = linesOf(text);
  if (lines.empty()) return failure(ErrorCode::kCorrupt, "{}: is empty", file.string());
  if (lines.size() > kMaxLights) {
    return failure(ErrorCode::kUnsupported, "{}: lists more than {} lights", file.string(),
                   kMaxLights);
  }
  std::size_t claimed = 0;
  const auto first = lines.front().text;
  const auto [end, error] = std::from_chars(first.data(), first.data() + first.size(), claimed);
  if (error != std::errc() || end != first.data() + first.size()) {
    return failure(ErrorCode::kCorrupt, "{}: expected the number of lights, found '{}'",
                   at(file, lines.front().number), quote(first));
  }

  std::vector<Listed> entries;
  UnitLengthCheck unitLength;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    const std::string where = at(file, lines[i].number);
    std::string_view rest = lines[i].text;
    Eigen::Vector3d vector;
    for (int k = 2; k >= 0; --k) {
      ASSIGN_OR_RETURN(vector[k], parseNumber(takeLastToken(rest), where));
    }
    if (rest.empty()) {
      return failure(ErrorCode::kCorrupt, "{}: expected an image's name and three numbers", where);
    }
    ASSIGN_OR_RETURN(vector, unitLength.normalise(vector, where));
    entries.push_back({lines[i].number, std::string(rest), vector});
  }
  if (entries.size() != claimed) {
    progress.warn(fmt::format("{}: says {} lights and lists {}; took those listed", file.string(),
                              claimed, entries.size()));
  }
  unitLength.report(file, progress);
  return entries;
}

// A table of numbers with one of two widths, a row a line.
struct Row {
  int line;
  std::vector<double> values;
};

Result<std::vector<Row>> parseTable(const fs::path& file, std::size_t columns,
                                    std::size_t otherColumns) {
  ASSIGN_OR_RETURN(const auto text, readFile(file, kMaxListBytes));
  std::vector<Row> rows;
  for (const auto& [number, content] : linesOf(text)) {
    Row row{number, {}};
    for (std::string_view rest = content; !rest.empty() && row.values.size() <= 3;) {
      ASSIGN_OR_RETURN(const double value, parseNumber(takeLastToken(rest), at(file, number)));
      row.values.push_back(value);
    }
    std::reverse(row.values.begin(), row.values.end());
    if (row.values.size() != columns && row.values.size() != otherColumns) {
      return failure(ErrorCode::kCorrupt, "{}: has {} numbers, expected {}", at(file, number),
                     row.values.size(),
                     columns == otherColumns ? fmt::format("{}", columns)
                                             : fmt::format("{} or {}", otherColumns, columns));
    }
    rows.push_back(std::move(row));
  }
  if (rows.empty()) return failure(ErrorCode::kCorrupt, "{}: is empty", file.string());
  return rows;
}

Result<std::vector<Listed>> parseDiligent(const fs::path& directions, const fs::path& names,
                                          Progress& progress) {
  ASSIGN_OR_RETURN(const auto rows, parseTable(directions, 3, 3));
  ASSIGN_OR_RETURN(const auto text, readFile(names, kMaxListBytes));
  const auto lines = linesOf(text);
  if (lines.size() != rows.size()) {
    return failure(ErrorCode::kCorrupt, "{}: names {} images, but {} has {} directions",
                   names.string(), lines.size(), directions.string(), rows.size());
  }
  std::vector<Listed> entries;
  UnitLengthCheck unitLength;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const auto& v = rows[i].values;
    ASSIGN_OR_RETURN(const auto direction,
                     unitLength.normalise({v[0], v[1], v[2]}, at(directions, rows[i].line)));
    entries.push_back({lines[i].number, std::string(lines[i].text), direction});
  }
  unitLength.report(directions, progress);
  return entries;
}

bool isFile(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

Result<fs::path> findLp(const fs::path& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) {
    return failure(ErrorCode::kNotFound, "{}: there is no such folder", folder.string());
  }
  std::vector<fs::path> found;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (entry->path().extension() == ".lp" && isFile(entry->path())) found.push_back(entry->path());
  }
  if (isFile(folder / "dirs.lp")) return folder / "dirs.lp";
  if (found.size() > 1) {
    std::sort(found.begin(), found.end());
    return failure(ErrorCode::kInvalidArgument,
                   "{}: holds several light lists ({}, {}...); name the one to use",
                   folder.string(), found[0].filename().string(), found[1].filename().string());
  }
  return found.empty() ? fs::path() : found.front();
}

// The listed path with '/', or, as lists travel between machines, its last part alone.
std::optional<fs::path> findImage(const std::string& name, const fs::path& listFolder,
                                  const fs::path& folder) {
  const fs::path path(name);
  for (const auto& base : {listFolder, folder}) {
    for (const auto& candidate : {base / path, base / path.filename()}) {
      if (isFile(candidate)) return candidate;
    }
  }
  return std::nullopt;
}

}  // namespace

Result<LightList> readLightList(const fs::path& folder, const std::optional<fs::path>& lp,
                                const std::optional<fs::path>& intensities, Progress& progress) {
  LightList list;
  std::vector<Listed> listed;
  ASSIGN_OR_RETURN(list.source, lp ? Result<fs::path>(*lp) : findLp(folder));
  if (!list.source.empty()) {
    ASSIGN_OR_RETURN(listed, parseLp(list.source, progress));
  } else if (isFile(folder / "light_directions.txt") && isFile(folder / "filenames.txt")) {
    list.source = folder / "light_directions.txt";
    list.diligent = true;
    ASSIGN_OR_RETURN(listed, parseDiligent(list.source, folder / "filenames.txt", progress));
  } else {
    return failure(ErrorCode::kNotFound,
                   "{}: holds no light list (an .lp file, or light_directions.txt with "
                   "filenames.txt)",
                   folder.string());
  }

  if (intensities)
    list.intensities = *intensities;
  else if (isFile(folder / "light_intensities.txt"))
    list.intensities = folder / "light_intensities.txt";
  std::vector<Row> table;
  if (!list.intensities.empty()) {
    ASSIGN_OR_RETURN(table, parseTable(list.intensities, 3, 1));
    if (table.size() != listed.size()) {
      return failure(ErrorCode::kCorrupt, "{}: has {} rows, but {} lists {} lights",
                     list.intensities.string(), table.size(), list.source.string(), listed.size());
    }
  }

  std::map<fs::path, int> seen;  // image to the line that named it
  for (std::size_t i = 0; i < listed.size(); ++i) {
    auto& [line, name, direction] = listed[i];
    std::replace(name.begin(), name.end(), '\\', '/');
    std::optional<std::array<double, 3>> intensity;
    if (!table.empty()) {
      const auto& values = table[i].values;
      if (!(*std::min_element(values.begin(), values.end()) > 0)) {
        return failure(ErrorCode::kCorrupt, "{}: intensities must be positive",
                       at(list.intensities, table[i].line));
      }
      intensity = {values.front(), values[values.size() / 2], values.back()};
    }
    const auto file = findImage(name, list.source.parent_path(), folder);
    if (!file) {
      progress.warn(
          fmt::format("{}: {} does not exist; skipped", at(list.source, line), quote(name)));
      ++list.skipped;
      continue;
    }
    if (const auto [first, isNew] = seen.try_emplace(*file, line); !isNew) {
      progress.warn(fmt::format("{}: {} is listed twice; kept line {}", at(list.source, line),
                                quote(name), first->second));
      ++list.skipped;
      continue;
    }
    list.entries.push_back({*file, name, direction, intensity});
  }
  if (list.entries.empty()) {
    return failure(ErrorCode::kNotFound, "{}: none of the {} images it lists exists",
                   list.source.string(), listed.size());
  }
  return list;
}

std::string formatLp(std::span<const NamedDirection> entries) {
  std::string text = fmt::format("{}\n", entries.size());
  for (const auto& [name, direction] : entries) {
    text += fmt::format("{} {} {} {}\n", name, direction.x(), direction.y(), direction.z());
  }
  return text;
}

}  // namespace lightsketch
