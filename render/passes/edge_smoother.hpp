// Smooths the edges of objects, hard shadows and shadow volumes in an image with one sample per
// pixel (docs/rendering.md#edges-without-multisampling). Meant for CPU rasterisers, where reading
// the image back is a copy in memory, and several samples per pixel are slow.
#pragma once

#include "render/edges/edge_blender.hpp"
#include "render/edges/frame_edges.hpp"
#include "render/passes/draw_context.hpp"

namespace penumbra {

class EdgeSmoother {
 public:
  // Smooths the finished image in the framebuffer, which still has its depth. Returns the number of
  // changed pixels.
  int smooth(const DrawContext& context, const FramePlan& plan);

 private:
  FrameEdges edges_;
  EdgeBlender blender_;
  EdgeImage image_;
};

}  // namespace penumbra
