// The room around the table: what the source camera sees beside the lamp, and the scene's weak
// ambient light. Boxes and rectangles only, intersected analytically.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

namespace lightsketch {

// Radiances of the rig are in units of a white matte surface that faces the lamp at 0.9 m.

struct RoomHit {
  Eigen::Vector3f position;
  Eigen::Vector3f normal;    // towards the room
  Eigen::Vector3f albedo;    // 0 where the surface only emits
  Eigen::Vector3f radiance;  // emitted, and reflected from the room's own lights
};

// A pane that mirrors the lamp: window and picture glass.
struct Pane {
  int axis;  // coordinate that is constant on it
  float value;
  Eigen::Vector3f low;  // bounds in the other two coordinates
  Eigen::Vector3f high;
};

// A small bare bulb on the ceiling.
struct Spot {
  Eigen::Vector3f position;
  float radius;
  float radiance;
};

// A luminous panel in the ceiling (constant z).
struct Panel {
  Eigen::Vector3f low;
  Eigen::Vector3f high;
  float radiance;
};

class Room {
 public:
  Room();
  // The surface seen from inside the room; spots are not in it (they are drawn with their glare).
  RoomHit trace(const Eigen::Vector3f& origin, const Eigen::Vector3f& direction) const;
  const std::vector<Pane>& panes() const { return panes_; }
  const std::vector<Spot>& spots() const { return spots_; }
  const std::vector<Panel>& panels() const { return panels_; }

 private:
  std::vector<Pane> panes_;
  std::vector<Spot> spots_;
  std::vector<Panel> panels_;
};

}  // namespace lightsketch
