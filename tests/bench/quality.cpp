// Quality against bytes on a synthetic set with shadows and highlights: the paper's setting, what
// others keep of the same pictures, and our own models of several sizes. Usage: bench_quality
// [--quick] [--plot FILE.svg]; or --model FILE.lsd: only makes the model of 4096 lights and 640 x
// 480 pixels at the quality "standard", for programs that draw it.
#include <fmt/core.h>
#include <fmt/ostream.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <numbers>

#include "pipeline/compress/compress.h"
#include "pipeline/relight/relighter.h"
#include "tests/bench/peers.h"
#include "tests/bench/synthetic_set.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

const char* verdict(bool good) { return good ? "ok" : "MISSED"; }

// `count` of the directions, spread over all by the golden ratio: no two rows of the grid alike.
std::vector<Eigen::Vector3d> someOf(const std::vector<Eigen::Vector3d>& all, int count) {
  std::vector<Eigen::Vector3d> some;
  for (int k = 0; k < count; ++k) {
    const double place = (k + 0.5) * (std::numbers::phi - 1);
    some.push_back(all[static_cast<std::size_t>((place - std::floor(place)) *
                                                static_cast<double>(all.size()))]);
  }
  return some;
}

struct Row {
  std::string name;
  std::uint64_t bytes;
  PictureQuality seen;    // under lights of the set
  PictureQuality unseen;  // midway between four of them
  double seconds;
};

class Bench {
 public:
  Bench(int width, int height, int side)
      : scene_(width, height),
        stack_(syntheticStack(scene_, hemisphereDirections(side))),
        seen_(syntheticStack(scene_, someOf(hemisphereDirections(side), 64))),
        unseen_(syntheticStack(scene_, someOf(hemisphereDirections(side, 1), 64))) {
    fmt::print("{} x {} pixels, {} lights; quality under {} of them and {} between them\n\n", width,
               height, stack_.size(), seen_.size(), unseen_.size());
    fmt::print("{:<34} {:>9} {:>7} {:>13} {:>16} {:>8}\n", "", "MB", "bits/px", "linear / sRGB",
               "unseen lights", "seconds");
  }

  const LightStack& stack() const { return stack_; }
  const std::vector<Row>& rows() const { return rows_; }

  Result<Row> add(const Peer& peer, double seconds) {
    ASSIGN_OR_RETURN(const PictureQuality seen, measureQuality(peer, seen_));
    ASSIGN_OR_RETURN(const PictureQuality unseen, measureQuality(peer, unseen_));
    const Row row{peer.name, peer.bytes, seen, unseen, seconds};
    const double pixels = static_cast<double>(scene_.width()) * scene_.height();
    fmt::print("{:<34} {:>9.2f} {:>7.0f} {:>6.2f} / {:<5.2f} {:>8.2f} / {:<5.2f} {:>8.1f}\n",
               row.name, static_cast<double>(row.bytes) * 1e-6,
               8 * static_cast<double>(row.bytes) / pixels, seen.linearPsnr, seen.srgbPsnr,
               unseen.linearPsnr, unseen.srgbPsnr, seconds);
    std::fflush(stdout);
    rows_.push_back(row);
    return row;
  }

  // One of our own models. Its bytes are those of its file, or with `plain` those of its numbers.
  Result<Row> addModel(const std::string& name, const CompressOptions& options, bool plain) {
    const auto start = std::chrono::steady_clock::now();
    SilentProgress progress;
    ASSIGN_OR_RETURN(CompressResult result, compress(stack_, options, progress));
    auto model = std::make_shared<RelightableModel>(std::move(result.model));
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    std::uint64_t bytes = model->factorBytes();
    if (!plain) {
      // What is drawn is what was read back.
      const fs::path file =
          fs::temp_directory_path() / fmt::format("bench_quality.{}.lsd", ::getpid());
      RETURN_IF_ERROR(saveModel(*model, file));
      bytes = fs::file_size(file);
      auto loaded = loadModel(file);
      fs::remove(file);
      ASSIGN_OR_RETURN(*model, std::move(loaded));
    }
    ASSIGN_OR_RETURN(const auto interpolator, interpolatorFor(*model));
    const auto predict = [model,
                          interpolator](const Eigen::Vector3d& light) -> Result<RadianceImage> {
      LightIntensities intensities = LightIntensities::Zero(model->lightCount(), 3);
      const auto& lights = model->lights;
      const auto known =
          std::find_if(lights.begin(), lights.end(), [&](const Eigen::Vector3d& one) {
            return (one - light).norm() < 1e-6;  // the file keeps directions in single precision
          });
      if (known != lights.end()) {
        intensities.row(known - lights.begin()).setOnes();
      } else {
        intensities.colwise() = interpolator.weights(light).cast<float>();
      }
      return relight(*model, intensities);
    };
    return add({name, bytes, predict}, seconds.count());
  }

 private:
  SyntheticScene scene_;
  LightStack stack_;
  LightStack seen_;
  LightStack unseen_;
  std::vector<Row> rows_;
};

// Quality (linear, under lights of the set) over bytes on a logarithmic axis; our models joined.
void plot(const std::vector<Row>& rows, const std::string& ours, const fs::path& path) {
  const auto [smallest, largest] = std::minmax_element(
      rows.begin(), rows.end(), [](const Row& a, const Row& b) { return a.bytes < b.bytes; });
  const auto [worst, best] = std::minmax_element(
      rows.begin(), rows.end(),
      [](const Row& a, const Row& b) { return a.seen.linearPsnr < b.seen.linearPsnr; });
  const double left = std::log10(0.8 * static_cast<double>(smallest->bytes));
  const double right = std::log10(1.6 * static_cast<double>(largest->bytes));
  const double bottom = std::floor(worst->seen.linearPsnr - 0.5);
  const double top = std::ceil(best->seen.linearPsnr + 0.5);
  const auto x = [&](double bytes) {
    return 60 + 700 * (std::log10(bytes) - left) / (right - left);
  };
  const auto y = [&](double psnr) { return 440 - 410 * (psnr - bottom) / (top - bottom); };

  std::ofstream out(path);
  fmt::print(out,
             "<svg xmlns='http://www.w3.org/2000/svg' width='800' height='500' "
             "font-family='sans-serif' font-size='12'>\n<rect width='800' height='500' "
             "fill='white'/>\n");
  for (double psnr = std::ceil(bottom / 2) * 2; psnr <= top; psnr += 2) {
    fmt::print(out,
               "<path d='M60 {0:.1f}H760' stroke='#ddd'/><text x='52' y='{1:.1f}' "
               "text-anchor='end'>{2:.0f}</text>\n",
               y(psnr), y(psnr) + 4, psnr);
  }
  for (double decade = 1e3; decade < 1e12; decade *= 10) {
    for (const double digit : {1.0, 2.0, 5.0}) {
      const double bytes = digit * decade;
      if (std::log10(bytes) < left || std::log10(bytes) > right) continue;
      fmt::print(out,
                 "<path d='M{0:.1f} 30V440' stroke='#ddd'/><text x='{0:.1f}' y='456' "
                 "text-anchor='middle'>{1:g}</text>\n",
                 x(bytes), bytes * 1e-6);
    }
  }
  fmt::print(out,
             "<text x='410' y='482' text-anchor='middle'>MB</text><text transform='translate(18 "
             "235) rotate(-90)' text-anchor='middle'>PSNR in linear light, dB</text>\n");
  std::vector<Row> curve;
  for (const Row& row : rows) {
    const bool own = row.name.starts_with(ours);
    if (own) curve.push_back(row);
    fmt::print(out, "<circle cx='{0:.1f}' cy='{1:.1f}' r='4' fill='{2}'/>",
               x(static_cast<double>(row.bytes)), y(row.seen.linearPsnr), own ? "#06c" : "#c40");
    if (!own) {
      fmt::print(out, "<text x='{:.1f}' y='{:.1f}'>{}</text>\n",
                 x(static_cast<double>(row.bytes)) + 8, y(row.seen.linearPsnr) + 4, row.name);
    }
  }
  std::sort(curve.begin(), curve.end(),
            [](const Row& a, const Row& b) { return a.bytes < b.bytes; });
  fmt::print(out, "<path fill='none' stroke='#06c' stroke-width='2' d='");
  for (std::size_t i = 0; i < curve.size(); ++i) {
    fmt::print(out, "{}{:.1f} {:.1f}", i == 0 ? 'M' : 'L', x(static_cast<double>(curve[i].bytes)),
               y(curve[i].seen.linearPsnr));
  }
  fmt::print(out, "'/>\n");
  if (!curve.empty()) {
    fmt::print(out, "<text x='{:.1f}' y='{:.1f}' fill='#06c' text-anchor='end'>{}</text>\n",
               x(static_cast<double>(curve.back().bytes)) - 10, y(curve.back().seen.linearPsnr) + 4,
               ours);
  }
  fmt::print(out, "</svg>\n");
}

Result<void> run(bool quick, const fs::path& plotFile) {
  Bench bench(quick ? 320 : 640, quick ? 240 : 480, quick ? 32 : 64);

  CompressOptions paper;
  paper.blockRank = 10;
  paper.rank = 200;
  paper.storage = Storage::kFloat32;
  paper.densify = CompressOptions::kDensifyOff;
  ASSIGN_OR_RETURN(const Row reference, bench.addModel("paper: b 10, q 200, f32", paper, true));

  using Clock = std::chrono::steady_clock;
  const auto secondsSince = [](Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
  };
  auto start = Clock::now();
  ASSIGN_OR_RETURN(const Peer pca, fitGlobalPca(bench.stack(), reference.bytes));
  ASSIGN_OR_RETURN(const Row pcaRow, bench.add(pca, secondsSince(start)));
  const LightBasis bases[] = {polynomialTexture(),       hemisphericalHarmonics(2),
                              hemisphericalHarmonics(3), hemisphericalHarmonics(4),
                              sphericalHarmonics(3),     sphericalHarmonics(4),
                              sphericalHarmonics(5)};
  start = Clock::now();
  ASSIGN_OR_RETURN(const auto fitted, fitBases(bench.stack(), bases));
  const double fitSeconds = secondsSince(start);  // of all of them
  double bestPeer = pcaRow.seen.linearPsnr;
  for (const Peer& peer : fitted) {
    ASSIGN_OR_RETURN(const Row row, bench.add(peer, fitSeconds));
    bestPeer = std::max(bestPeer, row.seen.linearPsnr);
  }
  std::vector<Row> ours;
  for (const double part : {16.0, 9.0, 4.0, 2.0, 1.0}) {
    CompressOptions options;
    options.densify = CompressOptions::kDensifyOff;
    options.budgetBytes = static_cast<std::uint64_t>(static_cast<double>(reference.bytes) / part);
    ASSIGN_OR_RETURN(
        const Row row,
        bench.addModel(fmt::format("lightsketch, paper's bytes / {}", part), options, false));
    ours.push_back(row);
  }
  const double paperPsnr = reference.seen.linearPsnr;
  const double gain = ours.back().seen.linearPsnr - paperPsnr;
  const double lead = ours.back().seen.linearPsnr - bestPeer;
  const bool ninth = ours[1].seen.linearPsnr >= paperPsnr && 9 * ours[1].bytes <= reference.bytes;
  fmt::print(
      "\npaper's quality ({:.2f} dB) in a ninth of its bytes: {:.2f} dB in {:.1f} times fewer  "
      "{}\n",
      paperPsnr, ours[1].seen.linearPsnr,
      static_cast<double>(reference.bytes) / static_cast<double>(ours[1].bytes), verdict(ninth));
  fmt::print("at the paper's bytes: {:+.2f} dB (bar +4)  {}\n", gain,
             verdict(gain >= 4 && ours.back().bytes <= reference.bytes));
  fmt::print("over the best of the peers: {:+.2f} dB (bar +5)  {}\n", lead, verdict(lead >= 5));
  if (!plotFile.empty()) plot(bench.rows(), "lightsketch", plotFile);
  return {};
}

Result<void> writeModel(const fs::path& file) {
  SilentProgress progress;
  ASSIGN_OR_RETURN(
      const CompressResult made,
      compress(syntheticStack(SyntheticScene(640, 480), hemisphereDirections(64)), {}, progress));
  RETURN_IF_ERROR(saveModel(made.model, file));
  fmt::print("{}\n", made.summary.describe());
  return {};
}

}  // namespace
}  // namespace lightsketch

int main(int argc, char** argv) {
  bool quick = false;
  std::filesystem::path plotFile;
  std::filesystem::path modelFile;
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--quick") == 0)
      quick = true;
    else if (std::strcmp(argv[i], "--plot") == 0 && i + 1 < argc)
      plotFile = argv[++i];
    else if (std::strcmp(argv[i], "--model") == 0 && i + 1 < argc)
      modelFile = argv[++i];
    else {
      fmt::print(stderr, "usage: bench_quality [--quick] [--plot FILE.svg] | --model FILE.lsd\n");
      return 2;
    }
  }
  const auto result =
      modelFile.empty() ? lightsketch::run(quick, plotFile) : lightsketch::writeModel(modelFile);
  if (!result) {
    fmt::print(stderr, "bench_quality: {}\n", result.error().message);
    return 1;
  }
  return 0;
}
