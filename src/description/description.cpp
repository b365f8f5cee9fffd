// SPDX-License-Identifier: Apache-2.0
#include "lot/description.hpp"

#include <algorithm>
#include <utility>

#include "description/wire.hpp"

namespace lot {
namespace {

/// FNV-1a over words of 64 bits in place of bytes, whose upper half is folded into the lower one.
class Hash {
 public:
  void add(std::uint64_t word) {
    value_ = (value_ ^ word) * 0x100000001b3;
    value_ ^= value_ >> 32;
  }
  /// Its size, then its bytes, eight in a word, the first one lowest; the rest of the last is zero.
  void add(std::string_view text) {
    add(text.size());
    std::uint64_t word = 0;
    for (std::size_t i = 0; i < text.size(); ++i) {
      word |= std::uint64_t{static_cast<unsigned char>(text[i])} << (8 * (i % 8));
      if (i % 8 == 7 || i + 1 == text.size()) add(std::exchange(word, 0));
    }
  }
  std::uint64_t value() const { return value_; }

 private:
  std::uint64_t value_ = 0xcbf29ce484222325;
};

/// Hashes a description from the root down. Which place of the list a type has does not count, nor
/// how often it stands there: only what a reader of a message would find.
class Walk {
 public:
  Walk(const Description& description, bool names) : all_(description), names_(names) {
    done_.resize(description.types.size());
  }
  /// A walk that ends early where there are more levels or steps.
  Walk(const Description& description, std::size_t levels, std::size_t steps)
      : Walk(description, false) {
    most_levels_ = levels;
    steps_left_ = steps;
  }

  /// Of the type at that place. 0: some field in it has no name, and names are asked for.
  std::uint64_t of(std::uint32_t place) {
    if (done_[place] != 0) return done_[place];
    if (steps_left_ == 0) return 1;
    --steps_left_;
    // A type within itself: how many levels above. What lies between is then this walk's only.
    if (const auto above = std::find(path_.rbegin(), path_.rend(), place); above != path_.rend()) {
      const auto levels = static_cast<std::size_t>(above - path_.rbegin());
      highest_ = std::min(highest_, path_.size() - 1 - levels);
      Hash hash;
      hash.add(kWithinItself);
      hash.add(levels);
      return hash.value();
    }
    const std::size_t level = path_.size();
    if (level == most_levels_) steps_left_ = 0;
    const std::size_t outer = highest_;
    highest_ = level;
    path_.push_back(place);
    const std::uint64_t value = names_ ? of_names(all_.types[place]) : of_layout(all_.types[place]);
    path_.pop_back();
    if (highest_ == level) done_[place] = value;  // alike wherever it stands
    highest_ = std::min(highest_, outer);
    return value;
  }
  bool has_nameless() const { return has_nameless_; }
  bool has_ended_early() const { return steps_left_ == 0; }

 private:
  static constexpr std::uint64_t kWithinItself = 255;

  std::uint64_t of_layout(const Description::Type& type) {
    Hash hash;
    hash.add(static_cast<std::uint64_t>(type.kind));
    hash.add(type.size);
    hash.add(type.count);
    hash.add(static_cast<std::uint64_t>(type.numerator));
    hash.add(static_cast<std::uint64_t>(type.denominator));
    if (type.kind != Kind::Struct && type.kind != Kind::Enum) hash.add(type.name);
    if (type.element != Description::kNone) hash.add(of(type.element));
    hash.add(type.fields.size());
    for (const Description::Field& field : type.fields) {
      hash.add(field.offset);
      hash.add(field.bit);
      hash.add(field.bits);
      hash.add(of(field.type));
    }
    return at_least_1(hash.value());
  }

  std::uint64_t of_names(const Description::Type& type) {
    Hash hash;
    if (type.element != Description::kNone) hash.add(of(type.element));
    hash.add(type.fields.size());
    for (const Description::Field& field : type.fields) {
      has_nameless_ |= field.name.empty();
      hash.add(field.name);
      hash.add(of(field.type));
    }
    return at_least_1(hash.value());
  }

  static std::uint64_t at_least_1(std::uint64_t value) { return std::max<std::uint64_t>(value, 1); }

  const Description& all_;
  bool names_;
  bool has_nameless_ = false;
  std::size_t most_levels_ = ~std::size_t{0};
  std::size_t steps_left_ = ~std::size_t{0};
  std::vector<std::uint64_t> done_;        ///< by place; 0: not yet
  std::vector<std::uint32_t> path_;        ///< the types that this one lies in
  std::size_t highest_ = ~std::size_t{0};  ///< the level that a type within itself has led to
};

}  // namespace

bool description::is_small(const Description& description) {
  Walk walk(description, kMostLevels, kMostSteps);
  (void)walk.of(0);
  return !walk.has_ended_early();
}

std::uint64_t Description::layout_hash() const { return Walk(*this, false).of(0); }

std::uint64_t Description::names_hash() const {
  Walk walk(*this, true);
  const std::uint64_t value = walk.of(0);
  return walk.has_nameless() ? 0 : value;
}

}  // namespace lot
