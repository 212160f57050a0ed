// What a model's stored factors give back of the pictures that it was made from. Internal to this
// folder.
#pragma once

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/compress.h"

namespace lightsketch {

// Over at most 64 pictures, fewer if they are large: 20 million pixels in all, but 8 pictures.
// `stack` holds the captured pictures of the model. Uses all cores.
Result<MeasuredError> measureError(const RelightableModel& model, const LightStack& stack,
                                   Progress& progress);

}  // namespace lightsketch
