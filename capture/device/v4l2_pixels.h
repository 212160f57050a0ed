// What V4L2 cameras send, as frames of ours. Values in, values out: no device is touched here.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "capture/frame/frame.h"
#include "capture/frame/result.h"

namespace lightsketch {

// A driver's format and one of ours that it becomes.
struct V4l2Conversion {
  std::uint32_t fourcc;
  PixelFormat format;
  bool linear;   // the sensor's counts as they are, not a picture made for the eye
  bool isExact;  // no count is changed; otherwise chroma is spread or JPEG's loss is there
};

// All that are understood, what is best for measuring first: linear formats by their depth, then
// colour in 8 bits (RGB3 as it is, YUYV and NV12 with chroma of 2 and 4 pixels, MJPG with loss),
// then grey in 8 bits (GREY, or the luma of the others).
std::span<const V4l2Conversion> v4l2Conversions();

// "YUYV"
std::string fourccName(std::uint32_t fourcc);

// One picture as a driver lays it out.
struct V4l2Layout {
  int width = 0;
  int height = 0;
  int bytesPerLine = 0;    // of the first plane
  bool isBt709 = false;    // matrix of YCbCr; otherwise BT.601
  bool fullRange = false;  // of YCbCr; otherwise Y is 16..235 and Cb and Cr are 16..240
};

// Fills the frame's format, size and bytes. Mono8 of a YCbCr format is its Y as it is sent.
// Fails with kCorrupt if the bytes are fewer than the layout needs, or are no whole JPEG of its
// size. Thread-safe.
Result<void> unpackV4l2(const V4l2Conversion& conversion, const V4l2Layout& layout,
                        std::span<const std::uint8_t> bytes, Frame& frame);

}  // namespace lightsketch
