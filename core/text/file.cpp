#include "core/text/file.hpp"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>
#include <new>
#include <string>

namespace penumbra {
namespace {

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

std::string why(int error) {
  return std::error_code(error, std::generic_category()).message();
}

}  // namespace

Result<std::vector<std::uint8_t>> read_file(const std::filesystem::path& path,
                                            std::size_t max_bytes) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (status.type() == std::filesystem::file_type::not_found)
    return fail("{}: no such file", path.string());
  if (!std::filesystem::exists(status))
    return fail("{}: cannot be read: {}", path.string(), error.message());
  if (!std::filesystem::is_regular_file(status))
    return fail("{}: is not a file; give a regular file", path.string());
  const std::uintmax_t size = std::filesystem::file_size(path, error);
  if (error) return fail("{}: cannot be read: {}", path.string(), error.message());
  if (size > max_bytes)
    return fail("{}: has {} bytes; at most {} are read", path.string(), size, max_bytes);
  const File file(std::fopen(path.c_str(), "rb"));
  if (!file) return fail("{}: cannot be opened: {}", path.string(), why(errno));
  try {
    std::vector<std::uint8_t> bytes(static_cast<std::size_t>(size));
    if (size > 0 && std::fread(bytes.data(), 1, bytes.size(), file.get()) != bytes.size())
      return fail("{}: cannot be read to its end", path.string());
    return bytes;
  } catch (const std::bad_alloc&) {
    return fail("{}: no memory for its {} bytes", path.string(), size);
  }
}

Result<void> write_file(const std::filesystem::path& path, std::span<const std::uint8_t> bytes) {
  File file(std::fopen(path.c_str(), "wb"));
  if (!file) return fail("{}: cannot be written: {}", path.string(), why(errno));
  if ((!bytes.empty() && std::fwrite(bytes.data(), 1, bytes.size(), file.get()) != bytes.size()) ||
      std::fclose(file.release()) != 0) {
    return fail("{}: cannot be written: {}", path.string(), why(errno));
  }
  return {};
}

}  // namespace penumbra
