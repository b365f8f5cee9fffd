// SPDX-License-Identifier: Apache-2.0
#include "mcap/compression.hpp"

#include <limits>
#include <new>
#include <stdexcept>

#include <lz4frame.h>
#include <zstd.h>

namespace lot::mcap {

/// Of a context of C.
template <auto release>
struct Release {
  template <class T>
  void operator()(T* context) const {
    release(context);
  }
};
using Lz4Out = std::unique_ptr<LZ4F_cctx, Release<LZ4F_freeCompressionContext>>;
using Lz4In = std::unique_ptr<LZ4F_dctx, Release<LZ4F_freeDecompressionContext>>;
using ZstdOut = std::unique_ptr<ZSTD_CCtx, Release<ZSTD_freeCCtx>>;

namespace {

/// `result`, which is no error of the library.
std::size_t lz4(std::size_t result) {
  if (LZ4F_isError(result) == 0) return result;
  throw std::runtime_error(std::string("lz4: ") + LZ4F_getErrorName(result));
}
std::size_t zstd(std::size_t result) {
  if (ZSTD_isError(result) == 0) return result;
  throw std::runtime_error(std::string("zstd: ") + ZSTD_getErrorName(result));
}

void uncompress_lz4(View from, std::span<std::byte> to) {
  LZ4F_dctx* made = nullptr;
  lz4(LZ4F_createDecompressionContext(&made, LZ4F_VERSION));
  const Lz4In context(made);
  std::size_t wants = 1;  // 0 at the end of a frame, behind which another one may begin
  while (!from.empty()) {
    std::size_t taken = from.size();
    std::size_t given = to.size();
    wants = LZ4F_decompress(made, to.data(), &given, from.data(), &taken, nullptr);
    if (LZ4F_isError(wants) != 0) throw Malformed("lz4 cannot uncompress it");
    if (taken == 0 && given == 0) throw Malformed("it stands for more bytes than it says");
    from = from.subspan(taken);
    to = to.subspan(given);
  }
  // What is left in the context comes without further input.
  std::size_t taken = 0;
  std::size_t given = wants != 0 ? to.size() : 0;
  if (wants != 0) wants = LZ4F_decompress(made, to.data(), &given, from.data(), &taken, nullptr);
  if (wants != 0) throw Malformed("its lz4 frame does not end");
  if (given != to.size()) throw Malformed("it stands for fewer bytes than it says");
}

}  // namespace

std::string_view name_of(Compression compression) {
  switch (compression) {
    case Compression::None:
      return "";
    case Compression::Lz4:
      return "lz4";
    case Compression::Zstd:
      return "zstd";
  }
  return "";
}

Compression compression_of(std::string_view name) {
  for (const auto compression : {Compression::None, Compression::Lz4, Compression::Zstd}) {
    if (name == name_of(compression)) return compression;
  }
  throw Malformed("its compression is not known: " + std::string(name.substr(0, 32)));
}

struct Compressor::State {
  Lz4Out lz4_context;
  LZ4F_preferences_t lz4_preferences{};
  ZstdOut zstd_context;
  Buffer out;

  std::span<std::byte> room(std::size_t bytes) {
    if (out.bytes().size() < bytes) out = Buffer(bytes);
    return out.bytes();
  }
  View compress_lz4(std::span<const View> pieces, std::size_t size);
  View compress_zstd(std::span<const View> pieces, std::size_t size);
};

Compressor::Compressor(Compression compression, int level) : state_(std::make_unique<State>()) {
  if (compression == Compression::Lz4) {
    LZ4F_cctx* made = nullptr;
    lz4(LZ4F_createCompressionContext(&made, LZ4F_VERSION));
    state_->lz4_context.reset(made);
    state_->lz4_preferences.compressionLevel = level;
    state_->lz4_preferences.frameInfo.blockSizeID = LZ4F_max4MB;
    state_->lz4_preferences.frameInfo.blockMode = LZ4F_blockIndependent;
  } else {
    state_->zstd_context.reset(ZSTD_createCCtx());
    if (!state_->zstd_context) throw std::bad_alloc();
    zstd(ZSTD_CCtx_setParameter(state_->zstd_context.get(), ZSTD_c_compressionLevel, level));
  }
}

Compressor::~Compressor() = default;
Compressor::Compressor(Compressor&&) noexcept = default;
Compressor& Compressor::operator=(Compressor&&) noexcept = default;

View Compressor::compress(std::span<const View> pieces) {
  const std::size_t size = size_of(pieces);
  return state_->lz4_context ? state_->compress_lz4(pieces, size)
                             : state_->compress_zstd(pieces, size);
}

View Compressor::State::compress_lz4(std::span<const View> pieces, std::size_t size) {
  lz4_preferences.frameInfo.contentSize = size;
  // Each piece by itself may fill a block that is begun, so each has its own bound.
  std::size_t bound = LZ4F_HEADER_SIZE_MAX + LZ4F_compressBound(0, &lz4_preferences);
  for (const View piece : pieces) bound += LZ4F_compressBound(piece.size(), &lz4_preferences);
  const auto to = room(bound);
  LZ4F_cctx* const context = lz4_context.get();
  std::size_t n = lz4(LZ4F_compressBegin(context, to.data(), to.size(), &lz4_preferences));
  for (const View piece : pieces) {
    n += lz4(LZ4F_compressUpdate(context, to.data() + n, to.size() - n, piece.data(), piece.size(),
                                 nullptr));
  }
  n += lz4(LZ4F_compressEnd(context, to.data() + n, to.size() - n, nullptr));
  return to.first(n);
}

View Compressor::State::compress_zstd(std::span<const View> pieces, std::size_t size) {
  const auto to = room(ZSTD_compressBound(size));
  ZSTD_CCtx* const context = zstd_context.get();
  zstd(ZSTD_CCtx_reset(context, ZSTD_reset_session_only));
  zstd(ZSTD_CCtx_setPledgedSrcSize(context, size));
  ZSTD_outBuffer frame{to.data(), to.size(), 0};
  for (const View& piece : pieces) {
    // With the end known at once zstd reads a single piece where it lies.
    const auto mode = &piece == &pieces.back() ? ZSTD_e_end : ZSTD_e_continue;
    ZSTD_inBuffer in{piece.data(), piece.size(), 0};
    std::size_t left = 0;
    do {
      left = zstd(ZSTD_compressStream2(context, &frame, &in, mode));
    } while (in.pos != in.size || (mode == ZSTD_e_end && left != 0));
  }
  return to.first(frame.pos);
}

std::uint64_t most_uncompressed(Compression compression, std::uint64_t compressed_bytes) {
  // lz4: a byte of a length stands for 255 bytes. zstd: a block of 4 bytes for 128 KiB.
  constexpr std::uint64_t kLz4 = 255;
  constexpr std::uint64_t kZstd = (128 << 10) / 4;
  if (compression == Compression::None) return compressed_bytes;
  const std::uint64_t ratio = compression == Compression::Lz4 ? kLz4 : kZstd;
  constexpr auto kMost = std::numeric_limits<std::uint64_t>::max();
  return compressed_bytes > kMost / ratio ? kMost : compressed_bytes * ratio;
}

void uncompress(Compression compression, View from, std::span<std::byte> to) {
  if (compression == Compression::Lz4) return uncompress_lz4(from, to);
  const std::size_t n = ZSTD_decompress(to.data(), to.size(), from.data(), from.size());
  if (ZSTD_isError(n) != 0) throw Malformed("zstd cannot uncompress it");
  if (n != to.size()) throw Malformed("it stands for fewer bytes than it says");
}

}  // namespace lot::mcap
