#include <cstdio>

int main() {
  std::puts(
      "penumbra "
      "0.1.0");
  return 0;
}
