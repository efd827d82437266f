// Converts the captured video to RGB pixel by pixel. Chroma is taken from the sample that covers
// the pixel, so that a 4:2:0 recording of the image has the same chroma samples.
uniform sampler2D plane0;
uniform sampler2D plane1;
uniform sampler2D plane2;

#if defined(WHOLE_PICTURE)
// From video.vert.glsl. Samples at luma pixel centres, which are at least a quarter texel from a
// texel's edge, so the result equals texelFetch(). On a CPU renderer this takes a third of the
// instructions.
in vec2 luma_uv;
flat in vec2 chroma_scale;
flat in vec3 flat_yuv_offset;
flat in mat3 flat_rgb_from_yuv;
#define yuv_offset flat_yuv_offset
#define rgb_from_yuv flat_rgb_from_yuv
#else
uniform vec3 yuv_offset;
uniform mat3 rgb_from_yuv;
uniform vec2 chroma_step;  // luma pixels per chroma sample, 1 or 2
#endif

vec3 rgb_of(vec3 yuv) {
  // Uses that two elements of the matrix are zero. The framebuffer clamps the result.
  yuv -= yuv_offset;
  float grey = rgb_from_yuv[0].r * yuv.x;
  return vec3(grey + rgb_from_yuv[2].r * yuv.z,
              grey + rgb_from_yuv[1].g * yuv.y + rgb_from_yuv[2].g * yuv.z,
              grey + rgb_from_yuv[1].b * yuv.y);
}

// Converts Y0 U Y1 V of two pixels to the YUV of one pixel.
vec3 yuv_of_pair(vec4 pair, int column) {
  return vec3((column & 1) == 0 ? pair.r : pair.b, pair.ga);
}

// Returns RGB; components may be outside 0 .. 1.
#if defined(WHOLE_PICTURE)
vec3 video_color() {
#if defined(VIDEO_RGB)
  return texture(plane0, luma_uv).rgb;
#elif defined(VIDEO_GREY)
  return rgb_of(vec3(texture(plane0, luma_uv).r, yuv_offset.yz));
#elif defined(VIDEO_YUYV)
  return rgb_of(yuv_of_pair(texture(plane0, luma_uv), int(gl_FragCoord.x)));
#else
  vec2 chroma = luma_uv * chroma_scale;
#if defined(VIDEO_NV12)
  return rgb_of(vec3(texture(plane0, luma_uv).r, texture(plane1, chroma).rg));
#else
  return rgb_of(
      vec3(texture(plane0, luma_uv).r, texture(plane1, chroma).r, texture(plane2, chroma).r));
#endif
#endif
}
#else
vec3 video_color(ivec2 at) {
#if defined(VIDEO_RGB)
  return texelFetch(plane0, at, 0).rgb;
#elif defined(VIDEO_GREY)
  return rgb_of(vec3(texelFetch(plane0, at, 0).r, yuv_offset.yz));
#elif defined(VIDEO_YUYV)
  return rgb_of(yuv_of_pair(texelFetch(plane0, ivec2(at.x >> 1, at.y), 0), at.x));
#elif defined(VIDEO_NV12)
  return rgb_of(vec3(texelFetch(plane0, at, 0).r, texelFetch(plane1, at >> 1, 0).rg));
#else
  ivec2 chroma = at / ivec2(chroma_step);
  return rgb_of(vec3(texelFetch(plane0, at, 0).r, texelFetch(plane1, chroma, 0).r,
                     texelFetch(plane2, chroma, 0).r));
#endif
}
#endif
