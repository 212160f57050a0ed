// What the pages show of a sketch's frames.
#pragma once

#include <Eigen/Core>
#include <QImage>
#include <QString>
#include <filesystem>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <vector>

#include "capture/frame/result.h"

namespace lightsketch {

struct SketchSummary {
  struct Frame {
    int id = 0;
    Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
    bool dropped = false;
    QString dropReason;
  };
  int width = 0;
  int height = 0;
  std::vector<Frame> frames;  // frames[i].id == i
  int active = 0;             // that are not dropped
  bool wholeSphere = false;   // some light comes from behind
  std::string holdOut;        // the rule where none is asked for; empty: too few frames for any
  std::set<int> heldOut;      // frames that it keeps back
  // A frame with light from the upper left, from among those kept back if there are any; -1: none.
  int example = -1;
};

// For background threads, as all of this.
Result<SketchSummary> summaryOf(const std::filesystem::path& sketch);

// Some frames spread over the sketch at one exposure, small.
struct Thumbnail {
  int id = 0;
  QImage image;
};
struct Thumbnails {
  float exposure = 1;
  std::vector<Thumbnail> pictures;
};
Thumbnails thumbnailsOf(const std::filesystem::path& sketch, const std::vector<int>& ids,
                        const QSize& size, const std::stop_token& stop);
// One frame, dropped or not, without the ambient light.
Result<QImage> frameImage(const std::filesystem::path& sketch, int id, float exposure);

}  // namespace lightsketch
