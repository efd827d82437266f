// Keeps in a recording all that is needed to draw its session again: the scene with every file that
// it names, the options that change images, and the program's version (docs/files.md#sessions).
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/error.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// Options of the command line that change images, with their values; a flag's value is "true".
using GivenOptions = std::vector<std::pair<std::string, std::string>>;
// Names of the options that a recording keeps.
[[nodiscard]] std::span<const char* const> kept_options();

// A file and its copy, whose path is relative to the recording's folder.
struct KeptFile {
  std::filesystem::path from;
  std::filesystem::path to;
};

// Chooses the paths of copied models: a folder for each model.
class KeptModels {
 public:
  // Returns the path of the copy of a model's file. The first time, adds all files of the model to
  // `files`.
  [[nodiscard]] std::filesystem::path keep(const Model& model, std::vector<KeptFile>& files);

 private:
  std::map<std::filesystem::path, std::filesystem::path> known_;  // copies by the model's file
};

// Content of the session's files at the start of a recording.
struct SessionHead {
  std::string scene_file;       // of the session, for people
  std::string scene_text;       // with paths of the copies
  std::vector<KeptFile> files;  // of the models and kernels
  KeptModels models;
  GivenOptions options;
};
// `scene`: as load_scene() read it from `scene_file`, perhaps with added objects, which are left
// out: they are events of the recording.
[[nodiscard]] Result<SessionHead> session_head(
    const std::filesystem::path& scene_file, const Scene& scene,
    const std::optional<std::filesystem::path>& kernel_file, GivenOptions options);

// Copies files into a recording, and lists them with their hashes in its session.json.
class SessionStore {
 public:
  // Writes the scene and copies its files. camera.yaml and tags.yaml are in the folder already.
  [[nodiscard]] Result<void> begin(const std::filesystem::path& recording, const SessionHead& head);
  // Copies the files of an added model.
  [[nodiscard]] Result<void> add(std::span<const KeptFile> files);

 private:
  struct Hashed {
    std::string file;
    std::string from;    // absolute path
    std::string sha256;  // lower-case hexadecimal
  };
  [[nodiscard]] Result<void> copy(const KeptFile& file);
  [[nodiscard]] Result<void> hash(const std::string& file, const std::string& from);
  [[nodiscard]] Result<void> write() const;

  std::filesystem::path recording_;
  std::string scene_file_;
  std::string started_;  // UTC
  GivenOptions options_;
  std::vector<Hashed> files_;
};

struct SessionRecord {
  std::filesystem::path scene;        // the copy
  GivenOptions options;               // only kept_options()
  std::vector<std::string> warnings;  // one line about each file that has changed, or is missing
};
// Reads session.json and compares the files with their hashes; nullopt for a recording without it.
[[nodiscard]] Result<std::optional<SessionRecord>> load_session_record(
    const std::filesystem::path& recording);

}  // namespace penumbra
