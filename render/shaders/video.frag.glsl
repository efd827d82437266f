// The video as captured, pixel by pixel: luma is fetched 1:1, chroma from the sample that covers the
// pixel (a 4:2:0 recording made of the picture gets its own chroma samples back).
layout(location = 0) out vec4 color;

uniform sampler2D plane0;
uniform sampler2D plane1;
uniform sampler2D plane2;
uniform vec3 yuv_offset;
uniform mat3 rgb_from_yuv;
uniform vec2 chroma_step;  // luma pixels per chroma sample, 1 or 2

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
#if defined(VIDEO_RGB)
  color = vec4(texelFetch(plane0, at, 0).rgb, 1.0);
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
  color = vec4(clamp(rgb_from_yuv * (yuv - yuv_offset), 0.0, 1.0), 1.0);
#endif
}
