// A grid over the picture, and where in the video each of its corners is.
layout(location = 0) in vec2 corner;      // NDC
layout(location = 1) in vec2 from_video;  // [px], (0, 0) is the centre of the top left one

out vec2 source;

void main() {
  source = from_video;
  gl_Position = vec4(corner, 0.0, 1.0);
}
