// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "mcap/compression.hpp"
#include "mcap/contents.hpp"
#include "mcap/crc.hpp"
#include "mcap/files.hpp"
#include "mcap/records.hpp"

namespace lot::mcap {

struct WriterOptions {
  Header header;                                ///< profile and library
  Compression compression = Compression::None;  ///< of chunks
  int level = 0;                                ///< of the compression; 0: its library's default
  std::uint64_t chunk_bytes = 1 << 20;          ///< how large a chunk may become, uncompressed
  bool crcs = true;                             ///< false: 0 in place of each, "none"
};

/// Writes a recording. docs/recording.md has the order of writes, and what each of them leaves.
///
/// Threads: one at a time.
/// Errors:  lot::Error, with the system's errno. What was written before can be read, and the next
///          call may go well again.
/// Memory:  one chunk, its compressed form, and the summary: about 200 bytes for each chunk.
/// Crash:   the file can be read up to the last chunk; recover() writes its summary.
class Writer {
 public:
  /// Makes the file. EEXIST: it is there already.
  explicit Writer(const std::string& path, WriterOptions options = {});
  /// Closes it, without a word when that fails.
  ~Writer();
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  /// Their `id` does not count: the number of the new one is returned. EOVERFLOW: there are 65535
  /// already. EINVAL: a channel's schema is not there.
  std::uint16_t add(Schema schema);
  std::uint16_t add(Channel channel);
  /// At once, behind the messages that came before.
  void add(const Attachment& attachment);
  void add(const Metadata& metadata);

  /// A message; its payload is the pieces, one behind the other. When it returns, the writer does
  /// not need them any more. When it throws, the message is lost. EINVAL: its channel is not there.
  void write(const MessageHead& head, std::span<const View> payload);

  /// Gives the file this mode, but for what the umask takes away. Before it is 0600.
  void permit(mode_t mode) noexcept;

  /// Writes the open chunk.
  void flush();
  /// Writes the open chunk and the summary. The file is closed then, also when it throws.
  void close();

  /// How large the file is, with the open chunk before it is compressed.
  std::uint64_t bytes() const { return written_ + chunk_.size(); }
  /// What has been written, without the open chunk.
  const Statistics& statistics() const { return contents_.statistics; }
  /// How many bytes the payloads of a channel's messages have that have been written.
  std::uint64_t payload_bytes(std::uint16_t channel) const {
    const auto found = payload_bytes_.find(channel);
    return found == payload_bytes_.end() ? 0 : found->second;
  }
  /// How many messages went down with chunks that could not be written, or were refused when their
  /// write() had to make room and failed.
  std::uint64_t lost() const { return lost_; }

 private:
  struct Noted {
    MessageHead head;
    std::uint64_t offset;
    std::uint64_t payload_bytes;
  };

  void require_open() const;
  /// Appends a record outside of chunks; where it begins.
  std::uint64_t append(const Bytes& record);
  void append(std::span<const View> pieces, const Crc& crc);
  template <class Record, class Count>
  std::uint16_t define(std::map<std::uint16_t, Record>& known, Record& record, Count& count);
  /// Writes the open chunk if a message of that length does not fit.
  void make_room(std::uint64_t record_bytes);
  /// Writes a chunk of these records, which has the noted messages.
  void write_chunk(std::span<const View> records);
  ChunkHead head_of_noted() const;
  Bytes index_noted(ChunkIndex& chunk) const;

  WriterOptions options_;
  std::string path_;
  std::optional<OutFile> file_;
  std::optional<Compressor> compressor_;
  Contents contents_;
  Crc crc_;
  Bytes chunk_;                                           ///< the records of the open chunk
  std::vector<Noted> noted_;                              ///< its messages
  std::map<std::uint16_t, std::uint64_t> payload_bytes_;  ///< of channels
  Bytes message_head_;         ///< of a message that has a chunk of its own
  std::uint64_t written_ = 0;  ///< how large the file is
  std::uint64_t lost_ = 0;
};

}  // namespace lot::mcap
