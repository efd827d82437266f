// A file that appears under its name only when it is whole.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Work goes to a file of this run's own beside PATH (see partial_path); commit() renames it to
// PATH. Without commit() the partial file is removed and what was at PATH before stays.
//
// A stream (see is_stream) is never replaced: commit() writes into it what was written to partial()
// until then, a place in memory, and closes it.
class OutputFile {
 public:
  // Creates the partial file. Fails, naming the path, where it can't be written: so a wrong path is
  // known before the work begins. A named pipe is opened by the first byte that goes to it, and
  // waits for its reader.
  [[nodiscard]] static Result<OutputFile> create(const std::filesystem::path& target);
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&& other) noexcept;
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;
  ~OutputFile();

  // As create() was given it, or "standard output": what messages name.
  [[nodiscard]] const std::filesystem::path& target() const { return asked_; }
  // Where to write until commit().
  [[nodiscard]] const std::filesystem::path& partial() const { return partial_; }
  // Adds text at the end. A stream receives it at once.
  [[nodiscard]] Result<void> append(std::string_view text);
  [[nodiscard]] Result<void> commit();
  // What went wrong with the partial file, told of the target.
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
  std::filesystem::path asked_;
  std::filesystem::path target_;   // that, or where the link leads
  std::filesystem::path partial_;  // empty once committed or moved from
  bool direct_ = false;            // a stream
  int memory_ = -1;                // of a stream: what partial() names
  int open_ = -1;                  // where append() writes: the stream, or the partial file
};

// "-" and any path of the descriptor 1, such as /dev/stdout.
[[nodiscard]] bool names_standard_output(const std::filesystem::path& path);
// Standard output, another open descriptor (/dev/fd/3), a pipe or a device: what is written along,
// and neither replaced nor read.
[[nodiscard]] bool is_stream(const std::filesystem::path& path);
// Reserves standard output for the output that is named so: all other printing goes to standard
// error from here on. The first OutputFile of standard output does the same.
void claim_standard_output();

// Commits all of them, or, where one can't be, none: what was at the others' paths is there again.
// Streams come last, for nothing is taken back from them.
[[nodiscard]] Result<void> commit_together(std::span<OutputFile* const> files);

// Writes a whole text to the partial file.
[[nodiscard]] Result<void> write_whole(OutputFile& file, const std::string& text);
// The same, and commits it.
[[nodiscard]] Result<void> write_text(OutputFile& file, const std::string& text);

// "PATH.partial-PID-ATTEMPT". Whoever makes it tries 0, 1, ... and takes the first that is not
// there: two runs with one target never share it.
[[nodiscard]] std::filesystem::path partial_path(const std::filesystem::path& target, int attempt);
inline constexpr int kPartialAttempts = 1000;

// A message with the path that the user gave in the place of the one that was written to meanwhile.
[[nodiscard]] Error renamed(const Error& error, const std::filesystem::path& written,
                            const std::filesystem::path& asked);

// Where a link leads, link after link, also when there is nothing yet: what is written to a link
// goes there. Any other path as it is.
[[nodiscard]] std::filesystem::path follow_links(const std::filesystem::path& path);

// Whether both name the same file or folder, which need not be there yet.
[[nodiscard]] bool same_path(const std::filesystem::path& a, const std::filesystem::path& b);
// Nothing is written over what is read, nor over what is written by the same run: fails with the
// first of `outputs` that is the same file as another one or as one of `inputs`. Empty paths and
// streams are no files.
[[nodiscard]] Result<void> check_written_once(std::span<const std::filesystem::path> outputs,
                                              std::span<const std::filesystem::path> inputs);
// Whether `path` is `folder` or lies somewhere below it; links are followed.
[[nodiscard]] bool lies_in(const std::filesystem::path& path, const std::filesystem::path& folder);

}  // namespace penumbra
