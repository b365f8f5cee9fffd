// SPDX-License-Identifier: Apache-2.0
#include "gateway/cdr_type.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <new>

#include <dds/ddsi/q_protocol.h>
#include <dds/ddsi/q_radmin.h>

namespace lot::gateway {
namespace {

constexpr std::uint64_t kWord = 4;  ///< of RTPS: what a sample is padded to

/// A type, as CycloneDDS has it.
struct Type : ddsi_sertype {
  std::shared_ptr<CdrShared> shared;
};

/// A sample, as CycloneDDS has it. One without a buffer is a key: since the topic has none, it says
/// no more than that there is an instance.
struct Sample : ddsi_serdata {
  std::shared_ptr<CdrShared> shared;
  std::unique_ptr<Buffer> buffer;
  const std::byte* first = nullptr;
  std::uint64_t size = 0;    ///< of the bytes; as many lie there as fill the last word
  std::uint64_t number = 0;  ///< CdrSample::number()
};

const Sample& sample_of(const ddsi_serdata* data) noexcept {
  return *static_cast<const Sample*>(data);
}

extern const ddsi_serdata_ops kSampleOps;
extern const ddsi_sertype_ops kTypeOps;

// ---- samples ----
//
// CycloneDDS is C: no exception may pass these functions. Null says that there is no memory.

std::unique_ptr<Sample> new_sample(const ddsi_sertype* type, ddsi_serdata_kind kind) {
  auto sample = std::make_unique<Sample>();
  ddsi_serdata_init(sample.get(), type, kind);
  sample->hash = type->serdata_basehash;  // one instance
  sample->shared = static_cast<const Type*>(type)->shared;
  return sample;
}

void free_sample(ddsi_serdata* data) {
  auto* const sample = static_cast<Sample*>(data);
  if (sample->buffer != nullptr) sample->shared->buffers.give(std::move(sample->buffer));
  delete sample;
}

/// A sample of so many bytes, which are the caller's to write: to `at`. Null: it is a key, or too
/// large.
std::unique_ptr<Sample> new_received(const ddsi_sertype* type, ddsi_serdata_kind kind,
                                     std::uint64_t size, std::byte*& at) {
  std::unique_ptr<Sample> sample = new_sample(type, kind);
  at = nullptr;
  if (kind != SDK_DATA) return sample;
  if (size > sample->shared->max_size) {
    sample->shared->too_large.fetch_add(1, std::memory_order_relaxed);  // relaxed: a count alone
    return nullptr;
  }
  const std::uint64_t padded = size + codec::padding(size, kWord);
  sample->buffer = sample->shared->buffers.take();
  at = sample->buffer->room(padded);
  std::fill(at + size, at + padded, std::byte{0});
  sample->first = at;
  sample->size = size;
  return sample;
}

/// CycloneDDS tells a reader of samples nothing of their numbers. They stand in the head of the
/// submessage, which lies in the same packet as the fragment; CycloneDDS has put its bytes into
/// this machine's order.
std::uint64_t number_of(const nn_rdata* fragment) {
  Data_DataFrag_common_t head;
  std::memcpy(&head, NN_RMSG_PAYLOADOFF(fragment->rmsg, NN_RDATA_SUBMSG_OFF(fragment)),
              sizeof head);
  const bool is_data =
      head.smhdr.submessageId == SMID_DATA || head.smhdr.submessageId == SMID_DATA_FRAG;
  if (!is_data) return 0;
  return static_cast<std::uint64_t>(head.writerSN.high) << 32 | head.writerSN.low;
}

ddsi_serdata* from_fragments(const ddsi_sertype* type, ddsi_serdata_kind kind,
                             const nn_rdata* fragment, std::size_t size) noexcept try {
  std::byte* at = nullptr;
  std::unique_ptr<Sample> sample = new_received(type, kind, size, at);
  if (at != nullptr) sample->number = number_of(fragment);
  std::uint64_t done = 0;
  for (; at != nullptr && fragment != nullptr; fragment = fragment->nextfrag) {
    const std::uint64_t end = std::min<std::uint64_t>(fragment->maxp1, size);
    if (end <= done || fragment->min > done) continue;  // fragments may lie over each other
    const unsigned char* const payload =
        NN_RMSG_PAYLOADOFF(fragment->rmsg, NN_RDATA_PAYLOAD_OFF(fragment));
    std::memcpy(at + done, payload + (done - fragment->min), end - done);
    done = end;
  }
  if (at != nullptr && done != size) return nullptr;
  return sample.release();
} catch (const std::bad_alloc&) {
  return nullptr;
}

ddsi_serdata* from_pieces(const ddsi_sertype* type, ddsi_serdata_kind kind,
                          ddsrt_msg_iovlen_t count, const ddsrt_iovec_t* pieces,
                          std::size_t size) noexcept try {
  std::byte* at = nullptr;
  std::unique_ptr<Sample> sample = new_received(type, kind, size, at);
  std::uint64_t done = 0;
  for (ddsrt_msg_iovlen_t i = 0; at != nullptr && i < count; ++i) {
    const std::uint64_t bytes = std::min<std::uint64_t>(pieces[i].iov_len, size - done);
    std::memcpy(at + done, pieces[i].iov_base, bytes);
    done += bytes;
  }
  if (at != nullptr && done != size) return nullptr;
  return sample.release();
} catch (const std::bad_alloc&) {
  return nullptr;
}

ddsi_serdata* from_keyhash(const ddsi_sertype* type, const ddsi_keyhash* /*hash*/) noexcept try {
  return new_sample(type, SDK_KEY).release();
} catch (const std::bad_alloc&) {
  return nullptr;
}

/// For dds_dispose() and the like alone: what has bytes is made as a sample.
ddsi_serdata* from_sample(const ddsi_sertype* type, ddsi_serdata_kind kind,
                          const void* /*sample*/) noexcept try {
  return kind == SDK_DATA ? nullptr : new_sample(type, kind).release();
} catch (const std::bad_alloc&) {
  return nullptr;
}

ddsi_serdata* to_untyped(const ddsi_serdata* data) noexcept try {
  std::unique_ptr<Sample> key = new_sample(data->type, SDK_KEY);
  key->type = nullptr;
  return key.release();
} catch (const std::bad_alloc&) {
  return nullptr;
}

std::uint32_t size_of(const ddsi_serdata* data) {
  const Sample& sample = sample_of(data);
  return static_cast<std::uint32_t>(sample.first == nullptr ? kWord : sample.size);
}

/// A key is a head and nothing else.
const std::byte* bytes_at(const Sample& sample, std::size_t offset) {
  static constexpr std::byte kHead[kWord] = {std::byte{0}, std::byte{1}, std::byte{0},
                                             std::byte{0}};
  return (sample.first == nullptr ? kHead : sample.first) + offset;
}

void to_bytes(const ddsi_serdata* data, std::size_t offset, std::size_t size, void* to) {
  std::memcpy(to, bytes_at(sample_of(data), offset), size);
}

ddsi_serdata* lend_bytes(const ddsi_serdata* data, std::size_t offset, std::size_t size,
                         ddsrt_iovec_t* lent) {
  lent->iov_base = const_cast<std::byte*>(bytes_at(sample_of(data), offset));
  lent->iov_len = size;
  return ddsi_serdata_ref(data);
}

void end_loan(ddsi_serdata* data, const ddsrt_iovec_t* /*lent*/) { ddsi_serdata_unref(data); }

/// Readers take samples as bytes (dds_takecdr).
bool to_sample(const ddsi_serdata* /*data*/, void* /*sample*/, void** /*from*/, void* /*to*/) {
  return false;
}
bool key_to_sample(const ddsi_sertype* /*type*/, const ddsi_serdata* /*data*/, void* /*sample*/,
                   void** /*from*/, void* /*to*/) {
  return true;
}

bool has_same_key(const ddsi_serdata* /*a*/, const ddsi_serdata* /*b*/) { return true; }

std::size_t print(const ddsi_sertype* /*type*/, const ddsi_serdata* data, char* to,
                  std::size_t size) {
  return static_cast<std::size_t>(
      std::snprintf(to, size, "%lu bytes", static_cast<unsigned long>(sample_of(data).size)));
}

void keyhash_of(const ddsi_serdata* /*data*/, ddsi_keyhash* to, bool /*force_md5*/) {
  std::memset(to, 0, sizeof *to);
}

// ---- types ----

void free_type(ddsi_sertype* type) {
  ddsi_sertype_fini(type);
  delete static_cast<Type*>(type);
}

void zero_samples(const ddsi_sertype* /*type*/, void* /*samples*/, std::size_t /*count*/) {}
void realloc_samples(void** /*to*/, const ddsi_sertype* /*type*/, void* /*old*/,
                     std::size_t /*old_count*/, std::size_t /*count*/) {}
void free_samples(const ddsi_sertype* /*type*/, void** /*samples*/, std::size_t /*count*/,
                  dds_free_op_t /*how*/) {}

/// Each topic has a type of its own, whose buffers and limit no other one has.
bool is_equal(const ddsi_sertype* a, const ddsi_sertype* b) { return a == b; }
/// CycloneDDS's table of types has room for 32 of one hash, and looks for ever for more.
std::uint32_t hash_of(const ddsi_sertype* type) {
  constexpr std::uint64_t kSpread = 0x9e3779b97f4a7c15;  // 2 to the 64, by the golden ratio
  return static_cast<std::uint32_t>((reinterpret_cast<std::uintptr_t>(type) * kSpread) >> 32);
}

const ddsi_serdata_ops kSampleOps = [] {
  ddsi_serdata_ops ops{};
  ops.eqkey = has_same_key;
  ops.get_size = size_of;
  ops.from_ser = from_fragments;
  ops.from_ser_iov = from_pieces;
  ops.from_keyhash = from_keyhash;
  ops.from_sample = from_sample;
  ops.to_ser = to_bytes;
  ops.to_ser_ref = lend_bytes;
  ops.to_ser_unref = end_loan;
  ops.to_sample = to_sample;
  ops.to_untyped = to_untyped;
  ops.untyped_to_sample = key_to_sample;
  ops.free = free_sample;
  ops.print = print;
  ops.get_keyhash = keyhash_of;
  return ops;
}();

const ddsi_sertype_ops kTypeOps = [] {
  ddsi_sertype_ops ops{};
  ops.version = ddsi_sertype_v0;
  ops.free = free_type;
  ops.zero_samples = zero_samples;
  ops.realloc_samples = realloc_samples;
  ops.free_samples = free_samples;
  ops.equal = is_equal;
  ops.hash = hash_of;
  return ops;
}();

}  // namespace

Bytes CdrSample::bytes() const noexcept {
  const Sample& sample = sample_of(data_);
  return {sample.first, sample.size};
}

std::uint64_t CdrSample::number() const noexcept { return sample_of(data_).number; }

CdrTopic::CdrTopic(dds_entity_t participant, const std::string& name, const std::string& type,
                   std::uint64_t max_size)
    : shared_(std::make_shared<CdrShared>(max_size)) {
  auto made = std::make_unique<Type>();
  constexpr bool kHasNoKey = true;
  ddsi_sertype_init(made.get(), type.c_str(), &kTypeOps, &kSampleOps, kHasNoKey);
  made->allowed_data_representation = DDS_DATA_REPRESENTATION_FLAG_XCDR1;
  made->shared = shared_;
  type_ = made.release();
  const dds_entity_t topic =
      dds_create_topic_sertype(participant, name.c_str(), &type_, nullptr, nullptr, nullptr);
  if (topic < 0) ddsi_sertype_unref(type_);
  topic_ = Entity(topic, name, "make the topic");
}

CdrSample CdrTopic::sample(const codec::Program& program, const Value& message) const {
  std::unique_ptr<Sample> made = new_sample(type_, SDK_DATA);
  CdrSample owner(made.get());
  Sample& sample = *made.release();
  sample.buffer = shared_->buffers.take();
  codec::Encoded& encoded = sample.buffer->encoded;
  encode(program, message, encoded);
  encoded.pad(kWord);
  const Bytes bytes = encoded.pieces().front();  // one: the encoder copies all
  sample.first = bytes.data();
  sample.size = bytes.size();
  return owner;
}

CdrSample CdrTopic::sample(Bytes bytes) const {
  ddsrt_iovec_t piece{};
  piece.iov_base = const_cast<std::byte*>(bytes.data());
  piece.iov_len = bytes.size();
  ddsi_serdata* const made = from_pieces(type_, SDK_DATA, 1, &piece, bytes.size());
  if (made == nullptr) throw std::bad_alloc();
  return CdrSample(made);
}

}  // namespace lot::gateway
