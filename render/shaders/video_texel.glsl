// The video as captured, pixel by pixel: luma is fetched 1:1, chroma from the sample that covers the
// pixel (a 4:2:0 recording made of the picture gets its own chroma samples back).
uniform sampler2D plane0;
uniform sampler2D plane1;
uniform sampler2D plane2;
uniform vec3 yuv_offset;
uniform mat3 rgb_from_yuv;
uniform vec2 chroma_step;  // luma pixels per chroma sample, 1 or 2

// May lie outside of 0 .. 1.
vec3 video_color(ivec2 at) {
#if defined(VIDEO_RGB)
  return texelFetch(plane0, at, 0).rgb;
#else
#if defined(VIDEO_GREY)
  vec3 yuv = vec3(texelFetch(plane0, at, 0).r, yuv_offset.yz);
#elif defined(VIDEO_YUYV)
  vec4 pair = texelFetch(plane0, ivec2(at.x >> 1, at.y), 0);  // Y0 U Y1 V
  vec3 yuv = vec3((at.x & 1) == 0 ? pair.r : pair.b, pair.ga);
#elif defined(VIDEO_NV12)
  vec3 yuv = vec3(texelFetch(plane0, at, 0).r, texelFetch(plane1, at >> 1, 0).rg);
#else
  ivec2 chroma = at / ivec2(chroma_step);
  vec3 yuv = vec3(texelFetch(plane0, at, 0).r, texelFetch(plane1, chroma, 0).r,
                  texelFetch(plane2, chroma, 0).r);
#endif
  // The matrix has two zeros. What is written to the picture is clamped there.
  yuv -= yuv_offset;
  float grey = rgb_from_yuv[0].r * yuv.x;
  return vec3(grey + rgb_from_yuv[2].r * yuv.z,
              grey + rgb_from_yuv[1].g * yuv.y + rgb_from_yuv[2].g * yuv.z,
              grey + rgb_from_yuv[1].b * yuv.y);
#endif
}
