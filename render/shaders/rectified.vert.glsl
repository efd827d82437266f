// A grid over the image, with each corner's position in the video.
layout(location = 0) in vec2 corner;      // NDC
layout(location = 1) in vec2 video_position;  // [px], (0, 0) is the top left pixel's centre

out vec2 source;

void main() {
  source = video_position;
  gl_Position = vec4(corner, 0.0, 1.0);
}
