// Boards found in the two real fisheye sets, against OpenCV's two searches on the same pictures.
// Usage: bench_boards [--ours]; --ours leaves OpenCV's searches out.
#include <fmt/core.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "calibration/lens/board_detection.h"

namespace {

using namespace lightsketch;
using Clock = std::chrono::steady_clock;

double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

enum class Search { kClassic, kSectors };

// In a child of its own that is ended after 10 s: these searches can take minutes.
bool openCvFinds(Search search, const std::filesystem::path& file) {
  fflush(stdout);
  const pid_t child = fork();
  if (child == 0) {
    cv::setNumThreads(1);
    const cv::Mat image = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
    std::vector<cv::Point2f> corners;
    bool found = false;
    try {
      found = search == Search::kClassic ? cv::findChessboardCorners(image, {6, 8}, corners)
                                         : cv::findChessboardCornersSB(image, {6, 8}, corners);
    } catch (const cv::Exception&) {
    }
    _exit(found ? 0 : 1);
  }
  const auto start = Clock::now();
  int status = 0;
  while (waitpid(child, &status, WNOHANG) == 0) {
    if (secondsSince(start) > 10) kill(child, SIGKILL);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

void row(const char* who, std::size_t found, std::size_t total, double seconds,
         const std::string& rest) {
  fmt::print("  {:<34}{:>3} of {:<3}{:>9.1f} ms a picture   {}\n", who, found, total,
             1000 * seconds / static_cast<double>(total), rest);
}

}  // namespace

int main(int argc, char** argv) {
  const bool peers = !(argc > 1 && std::strcmp(argv[1], "--ours") == 0);
  const std::filesystem::path data =
      std::filesystem::path(LIGHTSKETCH_SOURCE_DIR) / ".." / "shared" / "data" / "fisheye";
  BoardGeometry board;
  board.kind = BoardGeometry::Kind::kChessboard;
  board.columns = 6;
  board.rows = 8;
  board.spacingMetres = 0.0325;
  bool met = true;
  for (const auto& [name, bar] : {std::pair("fish_1", 15), {"copark86", 18}}) {
    const auto files = imagesInFolder(data / name);
    if (!files) {
      fmt::print("{}: absent, skipped\n", name);
      continue;
    }
    fmt::print("{}, 6 x 8 corners, bar {} boards\n", name, bar);
    if (peers) {
      for (const auto& [search, label] : {std::pair(Search::kClassic, "cv::findChessboardCorners"),
                                          {Search::kSectors, "cv::findChessboardCornersSB"}}) {
        const auto start = Clock::now();
        std::size_t found = 0;
        for (const auto& file : *files) found += openCvFinds(search, file);
        row(label, found, files->size(), secondsSince(start), "whole boards; cut off at 10 s");
      }
    }
    SilentProgress progress;
    const auto start = Clock::now();
    const auto search = detectBoards(*files, board, {}, progress);
    const double seconds = secondsSince(start);
    if (!search) {
      fmt::print("{}: {}\n", name, search.error().message);
      return 1;
    }
    std::size_t corners = 0;
    for (const auto& view : search->views()) corners += view.corners.size();
    row("lightsketch", search->found(), files->size(), seconds,
        fmt::format("{} of {} corners", corners,
                    files->size() * static_cast<std::size_t>(board.cornerCount())));
    for (const auto& picture : search->pictures) {
      if (!picture.reason.empty()) {
        fmt::print("    {}: {}\n", picture.view.name, picture.reason);
      } else if (picture.view.corners.size() < static_cast<std::size_t>(board.cornerCount())) {
        fmt::print("    {}: {} corners\n", picture.view.name, picture.view.corners.size());
      }
    }
    met = met && search->found() >= static_cast<std::size_t>(bar);
  }
  return met ? 0 : 1;
}
