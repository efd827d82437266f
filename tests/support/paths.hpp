// Paths of test data: the project's recordings, and the shared data beside the checkout.
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
// beside the checkout. Empty if no such folder exists; tests that need it are then skipped. A
// folder that $PENUMBRA_SHARED names but that does not exist is an error: a test run that asked for
// shared data must not pass by skipping.
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

// A temporary folder, removed at the end of the test.
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
