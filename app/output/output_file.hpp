// Files and folders that appear at their paths only when they are complete.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <system_error>

#include "core/error.hpp"

namespace penumbra {

// Writes to a partial file beside the target path; commit() renames it to the target. Without
// commit() the partial file is removed, and an existing file at the target stays.
//
// A stream (see is_stream()) is never replaced: partial() is then a file in memory, which commit()
// copies into the stream.
class OutputFile {
 public:
  // Creates the partial file; fails if the path can't be written. A named pipe is opened at the
  // first write, which waits for the pipe's reader.
  [[nodiscard]] static Result<OutputFile> create(const std::filesystem::path& target);
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&& other) noexcept;
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;
  ~OutputFile();

  // The path given to create(), or "standard output"; for messages.
  [[nodiscard]] const std::filesystem::path& target() const { return requested_; }
  // The path to write to until commit().
  [[nodiscard]] const std::filesystem::path& partial() const { return partial_; }
  // Appends text. A stream receives it immediately.
  [[nodiscard]] Result<void> append(std::string_view text);
  [[nodiscard]] Result<void> commit();
  // Replaces the partial file's path in an error by the target's.
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
  std::filesystem::path target_;   // requested_ after following links
  std::filesystem::path partial_;  // empty after commit() or a move
  bool is_stream_ = false;         // the target is a stream
  int memory_ = -1;                // descriptor of partial() if the target is a stream
  int open_ = -1;                  // descriptor of the stream or of the partial file
};

// Commits the complete lines of a partial text file, after an error of append().
void keep_complete_lines(OutputFile& file);

// Like OutputFile, for a folder: commit() renames a new folder beside the target to the target.
class OutputFolder {
 public:
  OutputFolder() = default;
  OutputFolder(const OutputFolder&) = delete;
  OutputFolder& operator=(const OutputFolder&) = delete;
  ~OutputFolder();

  // Creates the partial folder and missing parents of the target (see folder_name()).
  [[nodiscard]] Result<void> create(const std::filesystem::path& target);
  [[nodiscard]] const std::filesystem::path& target() const { return target_; }
  [[nodiscard]] const std::filesystem::path& partial() const { return partial_; }
  [[nodiscard]] tl::unexpected<Error> failed(const Error& cause) const;
  // Renames the folder to the target, which may be an empty folder. If `aside` is given, a folder
  // at the target is renamed first, and `aside` receives its new path.
  [[nodiscard]] std::error_code commit(std::filesystem::path* aside = nullptr);

 private:
  std::filesystem::path target_;
  std::filesystem::path partial_;  // empty before create() and after commit()
};

// Normalises a path and removes a trailing slash: "out/" becomes "out".
[[nodiscard]] std::filesystem::path folder_name(const std::filesystem::path& path);

// Returns true for "-" and for any path of descriptor 1, such as /dev/stdout.
[[nodiscard]] bool names_standard_output(const std::filesystem::path& path);
// Returns true for standard output, an open descriptor (/dev/fd/3), a pipe or a device. These are
// neither replaced nor read.
[[nodiscard]] bool is_stream(const std::filesystem::path& path);
// Reserves standard output for an output file and redirects all other printing to standard error.
// The first OutputFile on standard output calls this, too.
void claim_standard_output();

// Commits all files or none: if one commit fails, the old files at the other targets are restored.
// Streams are committed last, because they can't be restored.
[[nodiscard]] Result<void> commit_together(std::span<OutputFile* const> files);

// Writes a whole text to the partial file.
[[nodiscard]] Result<void> write_whole(OutputFile& file, const std::string& text);
// Writes a whole text and commits the file.
[[nodiscard]] Result<void> write_text(OutputFile& file, const std::string& text);

// Replaces the partial path `written` in an error by the user's path.
[[nodiscard]] Error renamed(const Error& error, const std::filesystem::path& written,
                            const std::filesystem::path& requested);

// Returns the target of a link, even of a dangling one. Returns any other path unchanged.
[[nodiscard]] std::filesystem::path follow_links(const std::filesystem::path& path);

// Returns true if both paths name the same file or folder, which need not exist.
[[nodiscard]] bool same_path(const std::filesystem::path& a, const std::filesystem::path& b);
// Fails if an output is the same file as another output or an input. Ignores "" and streams.
[[nodiscard]] Result<void> check_written_once(std::span<const std::filesystem::path> outputs,
                                              std::span<const std::filesystem::path> inputs);
// Returns true if `path` is `folder` or lies below it; follows links.
[[nodiscard]] bool lies_in(const std::filesystem::path& path, const std::filesystem::path& folder);

}  // namespace penumbra
