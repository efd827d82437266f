// Calibrates a camera from a folder of images of a printed target:
//   calibrate_folder IMAGES target.yaml camera.yaml
// `penumbra target` writes the target and its description.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <penumbra/calibration.hpp>
#include <vector>

namespace fs = std::filesystem;
namespace calibration = penumbra::calibration;

int main(int argc, char** argv) try {
  if (argc != 4) {
    std::fprintf(stderr, "usage: calibrate_folder IMAGES target.yaml camera.yaml\n");
    return 2;
  }
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(argv[1])) files.push_back(entry);
  std::sort(files.begin(), files.end());

  calibration::Calibrator calibrator(calibration::Target::load(argv[2]));
  for (const fs::path& file : files) {
    calibrator.add(file.filename().string(), calibration::Image::load(file).view());
  }
  const calibration::Calibration result = calibrator.solve();

  for (const auto& view : result.views()) {
    if (!view.used) std::printf("rejected: %s: %s\n", view.name.c_str(), view.reason.c_str());
  }
  const auto names = result.parameter_names();
  const auto covariance = result.covariance();
  const auto parameters = result.camera().parameters();
  const double values[] = {parameters.fx, parameters.fy, parameters.cx, parameters.cy};
  for (std::size_t i = 0; i < std::size(values); ++i) {
    std::printf("%s %.3f +- %.3f px\n", names[i].c_str(), values[i],
                std::sqrt(covariance[i * names.size() + i]));
  }
  result.save(argv[3]);
  std::printf("%s\n", result.verdict().c_str());
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "calibrate_folder: %s\n", error.what());
  return 1;
}
