// SPDX-License-Identifier: Apache-2.0
#include "transport/environment.hpp"

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <string>

#include "lot/error.hpp"

#include "lockfree_ring/ring.hpp"
#include "segment/layout.hpp"

namespace lot::transport {
namespace {

std::uint64_t parse_size(const char* text) {
  char* end = nullptr;
  errno = 0;
  std::uint64_t n = std::strtoull(text, &end, 10);
  const char unit = *end != '\0' ? *end++ : 'B';
  const unsigned shift = unit == 'B'                  ? 0
                         : unit == 'K' || unit == 'k' ? 10
                         : unit == 'M' || unit == 'm' ? 20
                         : unit == 'G' || unit == 'g' ? 30
                         : unit == 'T' || unit == 't' ? 40
                                                      : 64;
  const bool is_number = *text >= '0' && *text <= '9';  // strtoull takes blanks and signs, too
  if (!is_number || *end != '\0' || shift == 64 || errno != 0 || n == 0 ||
      n > (~std::uint64_t{0} >> shift)) {
    throw Error(EINVAL, std::string("LOT_SIZE=") + text, "not a size",
                "write a number of bytes, or one with K, M, G or T behind it");
  }
  return n << shift;
}

unsigned parse_permissions(const char* text) {
  char* end = nullptr;
  const unsigned long mode = std::strtoul(text, &end, 8);
  if (*end != '\0' || (mode & ~0666UL) != 0 || (mode & 0600) != 0600) {
    throw Error(EINVAL, std::string("LOT_PERMISSIONS=") + text, "not usable permissions",
                "write them in octal: 0600 (you), 0660 (and your group), 0606 (and all others), "
                "0666 (all users)");
  }
  return static_cast<unsigned>(mode);
}

bool parse_switch(const char* name, const char* text) {
  if (std::strcmp(text, "0") == 0 || std::strcmp(text, "1") == 0) return *text == '1';
  throw Error(EINVAL, std::string(name) + "=" + text, "neither 1 nor 0",
              "write 1 or 0, or leave it away");
}

void take_rights_from_environment(EngineOptions& options) {
  if (const char* v = environment("LOT_PERMISSIONS")) options.permissions = parse_permissions(v);
  if (const char* v = environment("LOT_USER")) options.user = v;
  if (const char* v = environment("LOT_GROUP")) options.group = v;
}

}  // namespace

const char* environment(const char* name) {
  const char* value = secure_getenv(name);
  return value != nullptr && *value != '\0' ? value : nullptr;
}

EngineOptions with_environment(EngineOptions options) {
  if (const char* v = environment("LOT_SEGMENT")) options.segment = v;
  if (const char* v = environment("LOT_DIR")) options.directory = v;
  if (const char* v = environment("LOT_SIZE")) options.size_bytes = parse_size(v);
  take_rights_from_environment(options);
  if (const char* v = environment("LOT_PERSIST")) options.persist = parse_switch("LOT_PERSIST", v);
  if (const char* v = environment("LOT_MLOCK")) options.lock_memory = parse_switch("LOT_MLOCK", v);
  if (options.name.empty()) options.name = program_invocation_short_name;
  const auto check = [](const char* what, std::uint64_t value, std::uint64_t most) {
    if (value == 0 || value > most) {
      throw Error(EINVAL, std::string("EngineOptions::") + what,
                  std::to_string(value) + " is out of range", "use 1 to " + std::to_string(most));
    }
  };
  check("processes", options.processes, segment::kMaxParticipants - 1);
  check("blocks", options.blocks, ring::kNoBlock - 1);
  check("topics", options.topics, 1U << 20);
  check("channels", options.channels, 1U << 20);
  check("readers", options.readers, 1U << 16);
  return options;
}

segment::Trust trust_of_environment() {
  EngineOptions options;
  take_rights_from_environment(options);
  return segment::Trust::of(options);
}

QueueEngine queue_engine(QueueEngine asked) {
  const char* name = environment("LOT_QUEUE");
  if (name == nullptr) return asked;
  if (std::strcmp(name, "ring") == 0) return QueueEngine::Ring;
  if (std::strcmp(name, "mutex") == 0) return QueueEngine::Mutex;
  throw Error(EINVAL, std::string("LOT_QUEUE=") + name, "not a queue engine",
              "write ring or mutex, or leave it away");
}

bool stamps(bool asked) {
  const char* v = environment("LOT_STAMP");
  return v != nullptr ? parse_switch("LOT_STAMP", v) : asked;
}

bool fast_lane(bool asked) {
  const char* v = environment("LOT_FAST_LANE");
  return v != nullptr ? parse_switch("LOT_FAST_LANE", v) : asked;
}

}  // namespace lot::transport
