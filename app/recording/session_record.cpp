#include "app/recording/session_record.hpp"

#include <fmt/chrono.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <fstream>
#include <iterator>
#include <memory>
#include <nlohmann/json.hpp>
#include <set>
#include <system_error>
#include <vector>

#include "app/libav.hpp"
#include "app/output/output_file.hpp"
#include "app/report/versions.hpp"
#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kRecordName = "session.json";
constexpr const char* kSceneName = "scene/scene.json";
constexpr const char* kKernelsName = "scene/kernels.json";
constexpr std::size_t kMaxRecordBytes = 4'000'000;
constexpr std::size_t kMaxKeptFiles = 100'000;

constexpr std::array kKeptOptions = {
    "--shadow", "--kernels",        "--light-mode", "--proxy",       "--translucency",
    "--layers", "--show-rays",      "--hide-walls", "--smooth",      "--rectified",
    "--msaa",   "--no-video-light", "--tracking",   "--pose-budget",
};

fs::path normal(const fs::path& path) {
  std::error_code ignored;
  return fs::absolute(path, ignored).lexically_normal();
}

// Returns the SHA-256 of a file.
Result<std::string> sha256_of(const fs::path& file) {
  PENUMBRA_TRY_VOID(load_libav());
  std::ifstream stream(file, std::ios::binary);
  if (!stream) return fail("{}: cannot be read; check its permissions", file.string());
  const std::unique_ptr<AVSHA, decltype(av_free)> sha(av_sha_alloc(), av_free);
  if (sha == nullptr || av_sha_init(sha.get(), 256) < 0) return fail("no memory for a hash");
  std::vector<char> buffer(1U << 20U);
  while (stream) {
    stream.read(buffer.data(), static_cast<std::streamsize>(buffer.size()));
    av_sha_update(sha.get(), reinterpret_cast<const std::uint8_t*>(buffer.data()),
                  static_cast<std::size_t>(stream.gcount()));
  }
  if (stream.bad()) return fail("{}: cannot be read; check the disk", file.string());
  std::array<std::uint8_t, 32> digest{};
  av_sha_final(sha.get(), digest.data());
  return fmt::format("{:02x}", fmt::join(digest, ""));
}

// Returns a path below the recording; fails for paths that lead elsewhere.
Result<fs::path> path_inside(const fs::path& recording, const std::string& text,
                             const std::string& where) {
  const fs::path path(text);
  const bool leaves = std::ranges::find(path, fs::path("..")) != path.end();
  if (text.empty() || path.is_absolute() || leaves || text.find('\0') != std::string::npos) {
    return fail("{}: \"{}\" is not a file inside the recording; record the session again", where,
                without_control_characters(shortened(text, 200)));
  }
  return recording / path;
}

std::string text_at(const Json& tree, const char* key) {
  const auto found = tree.find(key);
  return found != tree.end() && found->is_string() ? found->get<std::string>() : std::string();
}

// Replaces the paths of models and proxies by those of their copies.
void replace_paths(Json& object, const fs::path& folder,
                   const std::map<fs::path, fs::path>& copies) {
  for (const char* key : {"model", "proxy"}) {
    const auto entry = object.find(key);
    if (entry == object.end() || !entry->is_string()) continue;
    const auto copy = copies.find(normal(folder / entry->get<std::string>()));
    if (copy != copies.end()) {
      *entry = copy->second.lexically_relative(fs::path(kSceneName).parent_path()).string();
    }
  }
}

}  // namespace

std::span<const char* const> kept_options() {
  return kKeptOptions;
}

fs::path KeptModels::keep(const Model& model, std::vector<KeptFile>& files) {
  PENUMBRA_ASSERT(!model.files.empty());
  const fs::path own = normal(model.files.front());
  const auto [known, is_new] = known_.try_emplace(own);
  if (is_new) {
    const fs::path folder = fs::path("scene") / "models" / std::to_string(known_.size());
    known->second = folder / as_utf8(own.filename().string());  // events.jsonl is UTF-8
    std::set<fs::path> added;
    for (const fs::path& file : model.files) {
      const fs::path from = normal(file);
      if (!added.insert(from).second) continue;
      files.push_back({from, from == own ? known->second
                                         : folder / from.lexically_relative(own.parent_path())});
    }
  }
  return known->second;
}

Result<SessionHead> session_head(const fs::path& scene_file, const Scene& scene,
                                 const std::optional<fs::path>& kernel_file, GivenOptions options) {
  SessionHead head;
  head.scene_file = normal(scene_file).string();
  head.options = std::move(options);
  std::map<fs::path, fs::path> copies;
  for (const SceneObject& object : scene.objects) {
    for (const Model* model : {object.model.get(), object.proxy_model.get()}) {
      if (object.added || model == nullptr || model->files.empty()) continue;
      copies[normal(model->files.front())] = head.models.keep(*model, head.files);
    }
  }
  if (kernel_file) {
    head.files.push_back({normal(*kernel_file), kKernelsName});
    for (auto& [name, value] : head.options) {
      if (name == "--kernels") value = kKernelsName;
    }
  }
  PENUMBRA_ASSERT(scene.json != nullptr);
  Json tree = Json::parse(*scene.json);
  tree.erase("$schema");  // a path for editors
  for (const char* list : {"objects", "phantoms"}) {
    if (!tree.contains(list)) continue;
    for (Json& object : tree[list]) replace_paths(object, scene_file.parent_path(), copies);
  }
  head.scene_text = tree.dump(2) + "\n";
  return head;
}

Result<void> SessionStore::begin(const fs::path& recording, const SessionHead& head) {
  recording_ = recording;
  scene_file_ = head.scene_file;
  options_ = head.options;
  started_ = fmt::format(
      "{:%Y-%m-%dT%H:%M:%SZ}",
      fmt::gmtime(std::chrono::system_clock::to_time_t(std::chrono::system_clock::now())));
  std::error_code error;
  fs::create_directories(recording_ / "scene", error);
  if (error) {
    return fail("{}: cannot be made: {}; choose another place", (recording_ / "scene").string(),
                error.message());
  }
  PENUMBRA_TRY_VOID(write_text_file(recording_ / kSceneName, head.scene_text));
  PENUMBRA_TRY_VOID(hash("camera.yaml", ""));
  PENUMBRA_TRY_VOID(hash("tags.yaml", ""));
  PENUMBRA_TRY_VOID(hash(kSceneName, head.scene_file));
  return add(head.files);
}

Result<void> SessionStore::add(std::span<const KeptFile> files) {
  for (const KeptFile& file : files) PENUMBRA_TRY_VOID(copy(file));
  return write();
}

Result<void> SessionStore::copy(const KeptFile& file) {
  const fs::path to = recording_ / file.to;
  std::error_code error;
  fs::create_directories(to.parent_path(), error);
  if (!error) fs::copy_file(file.from, to, error);
  if (error) {
    return fail("{}: cannot be copied to {}: {}; free some space or choose another place",
                file.from.string(), to.string(), error.message());
  }
  return hash(file.to.string(), file.from.string());
}

Result<void> SessionStore::hash(const std::string& file, const std::string& from) {
  PENUMBRA_TRY(std::string sha256, sha256_of(recording_ / file));
  files_.push_back({file, from, std::move(sha256)});
  return {};
}

Result<void> SessionStore::write() const {
  Json tree;
  tree["program"] = "penumbra " + program_version();
  tree["started"] = started_;
  tree["scene"] = kSceneName;
  tree["scene_from"] = scene_file_;
  tree["options"] = Json::object();
  for (const auto& [name, value] : options_) tree["options"][name] = value;
  tree["files"] = Json::array();
  for (const Hashed& file : files_) {
    Json entry;
    entry["file"] = file.file;
    if (!file.from.empty()) entry["from"] = file.from;
    entry["sha256"] = file.sha256;
    tree["files"].push_back(std::move(entry));
  }
  PENUMBRA_TRY(auto out, OutputFile::create(recording_ / kRecordName));
  return write_text(out, tree.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

Result<std::optional<SessionRecord>> load_session_record(const fs::path& recording) {
  const fs::path file = recording / kRecordName;
  std::error_code ignored;
  if (!fs::exists(file, ignored)) return std::nullopt;
  PENUMBRA_TRY(const std::string text, read_text_file(file, kMaxRecordBytes));
  const Json tree = Json::parse(text, nullptr, false);
  const std::string name = file.string();
  if (!tree.is_object()) return fail("{}: is not a JSON object; remove the file", name);
  SessionRecord record;
  PENUMBRA_TRY(record.scene, path_inside(recording, text_at(tree, "scene"), name + ": scene"));
  if (const auto options = tree.find("options"); options != tree.end()) {
    for (const auto& [option, value] : options->items()) {
      const bool is_known = std::ranges::find(kKeptOptions, option) != kKeptOptions.end();
      // No other file than the copy is a kernel file.
      const bool leaves = option == "--kernels" && value != kKernelsName && value.is_string() &&
                          value.get<std::string>().find_first_of("./") != std::string::npos;
      if (!is_known || !value.is_string() || leaves) {
        record.warnings.push_back(fmt::format("{}: options: {} is ignored", name,
                                              without_control_characters(shortened(option, 200))));
        continue;
      }
      auto text_value = value.get<std::string>();
      if (option == "--kernels" && text_value == kKernelsName) {
        text_value = (recording / text_value).string();
      }
      record.options.emplace_back(option, std::move(text_value));
    }
  }
  const auto files = tree.find("files");
  if (files == tree.end() || !files->is_array() || files->size() > kMaxKeptFiles) {
    return fail("{}: files: is not a list; remove {} to replay without it", name, kRecordName);
  }
  for (const Json& entry : *files) {
    if (!entry.is_object()) return fail("{}: files: has an entry that is no object", name);
    PENUMBRA_TRY(const fs::path kept,
                 path_inside(recording, text_at(entry, "file"), name + ": files"));
    if (!fs::is_regular_file(kept, ignored)) {
      record.warnings.push_back(kept.string() + ": is missing, but the session used it");
      continue;
    }
    PENUMBRA_TRY(const std::string sha256, sha256_of(kept));
    if (sha256 != text_at(entry, "sha256")) {
      record.warnings.push_back(kept.string() +
                                ": has changed since the session was recorded; images may differ");
    }
  }
  return record;
}

}  // namespace penumbra
