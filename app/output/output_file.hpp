// Files and folders that appear under their names only when they are complete.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <system_error>

#include "core/error.hpp"

namespace penumbra {

// Writes to a partial file beside PATH; commit() renames it to PATH. Without commit() the partial
// file is removed, and a file at PATH stays.
//
// A stream (see is_stream) is never replaced: commit() copies partial(), then in memory, into it.
class OutputFile {
 public:
  // Creates the partial file; fails if the path can't be written. A named pipe is opened by its
  // first byte and waits for its reader.
  [[nodiscard]] static Result<OutputFile> create(const std::filesystem::path& target);
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&& other) noexcept;
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;
  ~OutputFile();

  // As given to create(), or "standard output": for messages.
  [[nodiscard]] const std::filesystem::path& target() const { return requested_; }
  // The path to write to until commit().
  [[nodiscard]] const std::filesystem::path& partial() const { return partial_; }
  // Adds text at the end. A stream receives it at once.
  [[nodiscard]] Result<void> append(std::string_view text);
  [[nodiscard]] Result<void> commit();
  // An error about the partial file, with the target's name.
  [[nodiscard]] tl::unexpected<Error> failed(const Error& cause) const;

 private:
  friend Result<void> commit_together(std::span<OutputFile* const> files);
  OutputFile() = default;
  [[nodiscard]] Result<void> create_partial();
  [[nodiscard]] Result<void> open_stream();
  [[nodiscard]] Result<void> write_memory_to_stream();
  [[nodiscard]] tl::unexpected<Error> not_written(int error) const;
  void swap(OutputFile& other) noexcept;
  void close_descriptors() noexcept;
  std::filesystem::path requested_;
  std::filesystem::path target_;   // requested_ with links followed
  std::filesystem::path partial_;  // empty once committed or moved from
  bool direct_ = false;            // a stream
  int memory_ = -1;                // of a stream: partial()
  int open_ = -1;                  // the stream, or the partial file
};

// The same for a folder: a new, empty one beside the target, which commit() renames.
class OutputFolder {
 public:
  OutputFolder() = default;
  OutputFolder(const OutputFolder&) = delete;
  OutputFolder& operator=(const OutputFolder&) = delete;
  ~OutputFolder();

  // Creates the partial folder, and missing parents of the target (see folder_name()).
  [[nodiscard]] Result<void> create(const std::filesystem::path& target);
  [[nodiscard]] const std::filesystem::path& target() const { return target_; }
  [[nodiscard]] const std::filesystem::path& partial() const { return partial_; }
  [[nodiscard]] tl::unexpected<Error> failed(const Error& cause) const;
  // Also over an empty folder. `aside`: a folder at the target is kept there.
  [[nodiscard]] std::error_code commit(std::filesystem::path* aside = nullptr);

 private:
  std::filesystem::path target_;
  std::filesystem::path partial_;  // empty before create() and after commit()
};

// Normalised, without a slash at the end: "out/" is "out".
[[nodiscard]] std::filesystem::path folder_name(const std::filesystem::path& path);

// "-" and any path of descriptor 1, such as /dev/stdout.
[[nodiscard]] bool names_standard_output(const std::filesystem::path& path);
// Standard output, another open descriptor (/dev/fd/3), a pipe or a device: neither replaced nor
// read.
[[nodiscard]] bool is_stream(const std::filesystem::path& path);
// Reserves standard output for an output: all other printing goes to standard error from now on.
// The first OutputFile of standard output does the same.
void claim_standard_output();

// Commits all of them or none: if one fails, the old files of the others are restored. Streams come
// last, as they can't be restored.
[[nodiscard]] Result<void> commit_together(std::span<OutputFile* const> files);

// Writes a whole text to the partial file.
[[nodiscard]] Result<void> write_whole(OutputFile& file, const std::string& text);
// The same, and commits it.
[[nodiscard]] Result<void> write_text(OutputFile& file, const std::string& text);

// A message about the partial path `written`, with the user's path instead.
[[nodiscard]] Error renamed(const Error& error, const std::filesystem::path& written,
                            const std::filesystem::path& requested);

// The target of a link, of a dangling one too; any other path as it is.
[[nodiscard]] std::filesystem::path follow_links(const std::filesystem::path& path);

// Returns true if both name the same file or folder, existing or not.
[[nodiscard]] bool same_path(const std::filesystem::path& a, const std::filesystem::path& b);
// Fails if one of `outputs` is the same file as another one or as one of `inputs`. Ignores empty
// paths and streams.
[[nodiscard]] Result<void> check_written_once(std::span<const std::filesystem::path> outputs,
                                              std::span<const std::filesystem::path> inputs);
// Returns true if `path` is `folder` or lies below it; follows links.
[[nodiscard]] bool lies_in(const std::filesystem::path& path, const std::filesystem::path& folder);

}  // namespace penumbra
