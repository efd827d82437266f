// A triangle that covers the image.
#if defined(WHOLE_PICTURE)
// Passed to video_texel.glsl as flat inputs, because some renderers (llvmpipe) load uniforms for
// each fragment but flat inputs once.
uniform vec3 yuv_offset;
uniform mat3 rgb_from_yuv;
uniform vec4 plane_extents;  // image size / size of the luma (xy) and chroma (zw) planes

out vec2 luma_uv;
flat out vec2 chroma_scale;
flat out vec3 flat_yuv_offset;
flat out mat3 flat_rgb_from_yuv;
#endif

void main() {
  vec2 corner = vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1));
#if defined(WHOLE_PICTURE)
  luma_uv = 2.0 * corner * plane_extents.xy;
  chroma_scale = plane_extents.zw / plane_extents.xy;
  flat_yuv_offset = yuv_offset;
  flat_rgb_from_yuv = rgb_from_yuv;
#endif
  gl_Position = vec4(corner * 4.0 - 1.0, 0.0, 1.0);
}
