flat in float light_left;
layout(location = 0) out vec4 factor;

void main() {
  factor = vec4(vec3(light_left), 1.0);  // blended: video * factor
}
