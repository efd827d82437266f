// Where tests find data: the project's own recordings, and the shared data beside the checkout
// where there is any.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>

namespace penumbra::test {

inline std::filesystem::path source_dir() {
  return PENUMBRA_SOURCE_DIR;
}
inline std::filesystem::path recordings_dir() {
  return source_dir() / "recordings";
}
inline std::filesystem::path program() {
  return PENUMBRA_PROGRAM;
}

// The folder of shared data (recordings, vectors, real photographs): $PENUMBRA_SHARED, or ../shared
// beside the checkout. Empty where there is none, or one that holds other things: then a test says
// so in a line and is skipped. One that was named but is not there is an error, as a test that was
// asked for must not pass by being skipped.
inline std::filesystem::path shared_dir() {
  const char* given = std::getenv("PENUMBRA_SHARED");
  const std::filesystem::path folder =
      given != nullptr ? std::filesystem::path(given) : source_dir().parent_path() / "shared";
  if (std::filesystem::is_directory(folder / "recordings" / "tabletop")) return folder;
  if (given != nullptr) {
    throw std::runtime_error("PENUMBRA_SHARED: " + folder.string() + " holds no shared recordings");
  }
  return {};
}

// A folder of its own that is removed at the end of the test.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string pattern =
        (std::filesystem::temp_directory_path() / "penumbra-test-XXXXXX").string();
    path_ = mkdtemp(pattern.data());
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace penumbra::test
