// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "lot/lot.hpp"

#include "random.hpp"

/// The messages. All their bytes follow from their stamp, so that a reader can check every one of
/// them, and a message of another is never taken for this one.
namespace lot::chaos {

/// The publisher of a message, and its number among that one's.
struct Place {
  std::uint32_t incarnation = 0;
  std::uint64_t number = 0;
};

struct Stamp {
  std::uint64_t serial;  ///< {maker's slot : 8 | counter : 56}
  std::uint64_t number;
  std::uint64_t twin_number;
  std::uint32_t incarnation;
  std::uint32_t twin_incarnation;  ///< a message may be pushed by two publishers; 0: it is not
  std::uint64_t words;             ///< of payload
  std::uint64_t seal;              ///< of all above
  std::int64_t pushed_at;          ///< on the clock that all processes share; not in the seal

  std::uint64_t sealed() const {
    std::uint64_t h = 0;
    for (const std::uint64_t part : {serial, number, twin_number,
                                     std::uint64_t{incarnation} << 32 | twin_incarnation, words}) {
      h = Random::mix(h ^ part);
    }
    return h;
  }
};

inline std::uint64_t word(std::uint64_t seal, std::uint64_t i) {
  return (seal ^ (i + 1) * 0x9e3779b97f4a7c15U) * 0xbf58476d1ce4e5b9U;
}

struct Plain {
  Stamp stamp;
  std::array<std::uint64_t, 9> data;
};

struct Frame {
  Stamp stamp;
  ShmVector<std::uint64_t> data;
  ShmString text;
};

/// What a reader saw in a frame, and in the one before.
struct Seen {
  Stamp stamp;
  ShmRef<const Frame> now;
  ShmRef<const Frame> before;
  std::uint64_t now_seal;
  std::uint64_t before_seal;
  std::uint64_t refs_seal;
};

inline std::size_t text_length(std::uint64_t seal) { return seal % 200; }
inline char text_letter(std::uint64_t seal, std::size_t i) {
  return static_cast<char>('a' + (seal >> (i % 32)) % 26);
}
inline std::uint64_t refs_seal(const Seen& m) {
  return Random::mix(m.stamp.seal ^ Random::mix(m.now_seal ^ Random::mix(m.before_seal)));
}

inline void fill(Plain& m) {
  for (std::size_t i = 0; i < m.data.size(); ++i) m.data[i] = word(m.stamp.seal, i);
}

/// May throw OutOfMemory.
inline void fill(Frame& m) {
  if (m.stamp.words % 3 == 0) {  // grows as it comes
    for (std::uint64_t i = 0; i < m.stamp.words; ++i) m.data.push_back(word(m.stamp.seal, i));
  } else {
    m.data.resize(m.stamp.words);
    for (std::uint64_t i = 0; i < m.stamp.words; ++i) m.data[i] = word(m.stamp.seal, i);
  }
  for (std::size_t i = 0; i < text_length(m.stamp.seal); ++i) {
    m.text.push_back(text_letter(m.stamp.seal, i));
  }
}

/// What is wrong with its bytes, or "".
inline std::string wrong(const Stamp& stamp) {
  return stamp.seal == stamp.sealed() ? "" : "the seal of its stamp is broken";
}

inline std::string wrong(const Plain& m) {
  if (auto w = wrong(m.stamp); !w.empty()) return w;
  for (std::size_t i = 0; i < m.data.size(); ++i) {
    if (m.data[i] != word(m.stamp.seal, i)) return "word " + std::to_string(i) + " is another's";
  }
  return "";
}

inline std::string wrong(const Frame& m) {
  if (auto w = wrong(m.stamp); !w.empty()) return w;
  if (m.data.size() != m.stamp.words) {
    return std::to_string(m.data.size()) + " words, not " + std::to_string(m.stamp.words);
  }
  const std::uint64_t* data = m.data.data();
  for (std::uint64_t i = 0; i < m.stamp.words; ++i) {
    if (data[i] != word(m.stamp.seal, i)) {
      return "word " + std::to_string(i) + " of " + std::to_string(m.stamp.words) + " is another's";
    }
  }
  if (m.text.size() != text_length(m.stamp.seal)) return "its text has another length";
  for (std::size_t i = 0; i < m.text.size(); ++i) {
    if (m.text[i] != text_letter(m.stamp.seal, i)) return "its text is another's";
  }
  return "";
}

inline std::string wrong(const Seen& m) {
  if (auto w = wrong(m.stamp); !w.empty()) return w;
  if (m.refs_seal != refs_seal(m)) return "what it says of its references is another's";
  for (const auto& [ref, seal] :
       {std::pair(m.now.get(), m.now_seal), std::pair(m.before.get(), m.before_seal)}) {
    if (ref == nullptr) {
      if (seal != 0) return "a reference is gone";
      continue;
    }
    if (ref->stamp.seal != seal) return "it refers to another message";
    if (auto w = wrong(*ref); !w.empty()) return "what it refers to: " + w;
  }
  return "";
}

}  // namespace lot::chaos
