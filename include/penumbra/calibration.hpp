// Camera calibration from images of a printed target, or from its corners. The methods are in
// docs/calibration.md.
//
// Board frame: that of the tag map, or the board's centre, x right, y up on the sheet, z out of it.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <penumbra/api.hpp>
#include <penumbra/camera.hpp>
#include <penumbra/types.hpp>
#include <string>
#include <vector>

namespace penumbra::calibration {

using types::CameraFileFormat;
using types::CameraModel;
using types::CameraParameters;
using types::DistortionModel;
using types::Image;
using types::ImageView;
using types::Vector2;
using types::Vector3;

// A calibration target. Immutable; copies are cheap and share their data.
class PENUMBRA_API Target {
 public:
  // Reads what `penumbra target` writes: tags.yaml, or a target.yaml of a chessboard, a ChArUco
  // board or an AprilGrid (Kalibr's format).
  [[nodiscard]] static Target load(const std::filesystem::path& file);
  // `columns`, `rows`: inner corners.
  [[nodiscard]] static Target chessboard(int columns, int rows, double square_m);
  Target(const Target&);
  Target& operator=(const Target&);
  ~Target();

  [[nodiscard]] std::string description() const;      // "6 x 6 tags of 30 mm"
  [[nodiscard]] std::vector<Vector3> points() const;  // corners in the board frame [m]

 private:
  friend struct Access;
  struct Impl;
  PENUMBRA_LOCAL explicit Target(std::shared_ptr<const Impl> impl);
  std::shared_ptr<const Impl> impl_;
};

struct Options {
  std::optional<DistortionModel> model = {};  // else chosen by cross-validation
  // Calibrator solves the most different views; memory holds twice this number of images.
  int max_views = 60;
};

enum class Grade { good, usable, poor };

struct ViewResult {
  std::string name;
  bool used = false;
  std::string reason;   // why it is not used
  double rms_px = 0.0;  // reprojection error, 2-D, without outliers
};

// A solved camera. Immutable; copies are cheap and share their data.
class PENUMBRA_API Calibration {
 public:
  Calibration(const Calibration&);
  Calibration& operator=(const Calibration&);
  ~Calibration();

  [[nodiscard]] CameraModel camera() const;
  // Writes the camera with its uncertainty. `date`: "2026-03-01", or empty.
  void save(const std::filesystem::path& file, const std::string& date = {},
            CameraFileFormat format = CameraFileFormat::ros) const;

  // Names of the lens parameters: fx fy cx cy k1 ... Their values are in camera().
  [[nodiscard]] std::vector<std::string> parameter_names() const;
  // Covariance of these parameters, row by row. Includes the correlation of a view's residuals.
  [[nodiscard]] std::vector<double> covariance() const;
  [[nodiscard]] double rms_px() const;                      // 2-D, without outliers
  [[nodiscard]] std::optional<double> held_out_px() const;  // rms_px of cross-validation
  // Standard deviation of the projection along its worst direction [px]: mean and maximum over the
  // image. Infinite if the distortion is not monotonic in the image.
  [[nodiscard]] double projection_mean_px() const;
  [[nodiscard]] double projection_largest_px() const;
  [[nodiscard]] Grade grade() const;
  [[nodiscard]] std::string verdict() const;              // one line: grade, why, and what to do
  [[nodiscard]] std::vector<std::string> advice() const;  // "no views near the top left", ...
  [[nodiscard]] std::vector<ViewResult> views() const;

 private:
  friend struct Access;
  struct Impl;
  PENUMBRA_LOCAL explicit Calibration(std::shared_ptr<const Impl> impl);
  std::shared_ptr<const Impl> impl_;
};

// Calibrates from images, as `penumbra calibrate` does with a folder of images: it estimates no row
// time. Use an object from one thread at a time. A moved-from object can only be assigned to or
// destroyed; its functions throw.
class PENUMBRA_API Calibrator {
 public:
  explicit Calibrator(const Target& target, const Options& options = {});
  Calibrator(Calibrator&&) noexcept;
  Calibrator& operator=(Calibrator&&) noexcept;
  ~Calibrator();

  // Searches an image for the target. An image that can't be used is listed in
  // Calibration::views(). Throws if the image is empty or its size differs from that of the first
  // image. `name`: in messages.
  void add(const std::string& name, const ImageView& image);

  // Solves. Throws with one line that explains what the images lack. Takes seconds to minutes. The
  // object is empty afterwards, also if this throws: the next add() begins another calibration.
  [[nodiscard]] Calibration solve();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// A corner of the target in an image.
struct Corner {
  int point = 0;  // index into Target::points(), or into the points of the board
  Vector2 pixel{0.0, 0.0};
};
struct CornerView {
  std::string name;
  std::vector<Corner> corners;
};

// Calibrates from corners that another program detected. `points`: in the board frame [m], at least
// four in a plane or not. `width`, `height`: size of the images [px]. Throws for fewer than 3
// views, a corner that is outside the image or named twice in a view, and views that determine no
// camera.
[[nodiscard]] PENUMBRA_API Calibration calibrate(int width, int height,
                                                 const std::vector<Vector3>& points,
                                                 const std::vector<CornerView>& views,
                                                 const Options& options = {});

}  // namespace penumbra::calibration
