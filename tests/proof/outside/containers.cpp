// SPDX-License-Identifier: Apache-2.0

// The arena of a message, and each container of a message, against std's: random operations on
// several containers of several messages, nested ones too, while the messages are built, shared,
// published, and handed to another participant and back. After each step
//
//  - each container has what std's has, and the program has seen the same of it;
//  - the pieces of all messages are aligned, lie in their own message's memory, and none overlaps
//    another one;
//  - each extent says exactly how many pieces live in it;
//  - under AddressSanitizer what a container has given back is poisoned, so that a touch ends the
//    run.
//
// In the end no memory of a message is left.

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "documents.hpp"
#include "pieces.hpp"
#include "run.hpp"
#include "support/janitor.hpp"
#include "support/processes.hpp"
#include "transport/participant.hpp"

namespace lot::outside {
namespace {

using detail::Arena;
using detail::Build;
using segment::kGranule;
using transport::Participant;

const std::vector<Mistake> kMistakes{
    {"forget", "a piece is not given back"},
    {"merge", "the arena takes back more than was given back"},
    {"short", "a piece is half as long as it should be"},
    {"askew", "a piece is not aligned"},
    {"twice", "a piece is handed out a second time"},
    {"letter", "a container has lost an element"},
    {"stale", "a piece is read after it was given back (AddressSanitizer finds it)"},
};

/// Which mistake is made, and how often it could have been.
std::string plant;
unsigned chances = 0;
bool planted(std::string_view mistake) { return plant == mistake && ++chances % 8 == 0; }

/// Two participants, as if in two processes: a directory that is spelt otherwise is another one.
class Place {
 public:
  Place() : options_(options()), engines_{engine(""), engine("/.")} {}

  ShmEngine& engine(std::size_t side) { return engines_[side]; }
  /// What the segment holds, when each participant has given back what lies idle.
  testing::Audit audit() {
    for (Participant* p : participants_) {
      p->stock().trim(transport::Stock::kNobody);
      p->reaper().collect();
    }
    return testing::Audit((*participants_.begin())->segment());
  }
  /// The one that has mapped the message.
  Participant& at(const void* message) {
    Participant* const p = Participant::at(message);
    require(p != nullptr, "a message lies in the segment");
    if (std::find(participants_.begin(), participants_.end(), p) == participants_.end()) {
      participants_.push_back(p);
    }
    return *p;
  }

 private:
  static EngineOptions options() {
    EngineOptions options = testing::fresh(48 << 20);
    options.processes = 4;
    options.blocks = 256;
    options.topics = 16;
    options.channels = 32;
    options.readers = 8;
    return options;
  }
  ShmEngine engine(const char* spelling) const {
    EngineOptions options = options_;
    options.directory += spelling;
    return ShmEngine(options);
  }

  EngineOptions options_;
  ShmEngine engines_[2];
  std::vector<Participant*> participants_;
};

/// A document in a message, and std's beside it. The last one of a gallery has no message.
template <template <class> class D>
struct Case {
  ShmUniquePtr<D<Shm>> unique{};
  ShmSharedPtr<D<Shm>> shared{};  ///< it grows on, but what it gives back stays
  D<Shm> in_private_memory{};
  D<Std> model{};
  std::size_t side = 0;
  bool is_message() const { return unique || shared; }
  D<Shm>& real() { return unique ? *unique : shared ? *shared : in_private_memory; }
};

/// A piece, by its place in the segment.
struct Located {
  std::uint64_t begin, end;
};

/// All documents of one kind.
template <template <class> class D>
class Gallery {
 public:
  Gallery(Place& place, const char* name, bool counts, Random& random)
      : place_(place),
        name_(name),
        counts_(counts),
        random_(random),
        pusher_(place.engine(0).advertise<D<Shm>>(name)),
        puller_(place.engine(1).subscribe<D<Shm>>(name)),
        there_(queues(place, std::string(name) + "_there")),
        back_(queues(place, std::string(name) + "_back")) {
    if (random.chance(50)) pusher_.reserve(2, 100'000);
    for (std::size_t i = 0; i + 1 < cases_.size(); ++i) renew(cases_[i]);
  }

  void step() {
    Case<D>& chosen = cases_[random_.below(cases_.size())];
    switch (random_.below(32)) {
      case 0:
        if (chosen.is_message()) renew(chosen);
        break;
      case 1:
        if (chosen.unique && chosen.side == 0) publish(chosen);
        break;
      case 2:
        if (chosen.unique && chosen.side == 0) chosen.shared = std::move(chosen.unique);
        break;
      case 3:
      case 4:
        if (chosen.unique) hand_over(chosen);
        break;
      default:
        change_both(chosen, cases_[random_.below(cases_.size())]);
    }
    compare();
  }

  void compare() {
    for (Case<D>& c : cases_) require(same(c.real(), c.model), "what a document has");
  }
  /// Adds where the pieces lie.
  void locate(std::vector<Located>& all) {
    for (Case<D>& c : cases_) {
      if (c.is_message()) locate(c.real(), c.side == 0, all);
    }
  }

 private:
  using Items = ShmQueue<ShmUniquePtr<D<Shm>>>;
  static std::array<Items, 2> queues(Place& place, const std::string& name) {
    return {place.engine(0).template queue<ShmUniquePtr<D<Shm>>>(name),
            place.engine(1).template queue<ShmUniquePtr<D<Shm>>>(name)};
  }

  void renew(Case<D>& c) {
    c = Case<D>();
    c.unique = random_.chance(70) ? pusher_.loan() : place_.engine(0).template make<D<Shm>>();
  }

  void publish(Case<D>& c) {
    require(pusher_.push(std::move(c.unique)) == Status::Ok, "a push");
    const auto seen = puller_.try_pull();
    require(seen && same(*seen, c.model), "a message is another one when it is read");
    const D<Shm> copy = *seen;  // an ordinary private one
    require(same(copy, c.model), "a copy of a message");
    renew(c);
  }

  /// To the other participant, which may change what it has taken.
  void hand_over(Case<D>& c) {
    auto& queue = c.side == 0 ? there_ : back_;
    require(queue[c.side].try_put(std::move(c.unique)) == Status::Ok, "a put");
    c.side = 1 - c.side;
    auto item = queue[c.side].try_pop();
    require(item && *item, "an item that was put is popped");
    c.unique = std::move(*item);
  }

  void change_both(Case<D>& c, Case<D>& other) {
    const bool one_memory = &c == &other || (!c.is_message() && !other.is_message());
    Random again = random_;
    std::uint64_t seen = 0;
    try {
      seen = change_part(c.real(), other.real(), one_memory, random_);
    } catch (const OutOfMemory&) {  // it may have happened in part
      mend_after_failure(c.real());
      mend_after_failure(other.real());
      c.model = as<D<Std>>(c.real());
      other.model = as<D<Std>>(other.real());
      return;
    }
    const std::uint64_t stds = change_part(c.model, other.model, one_memory, again);
    if (seen != stds) {
      throw Differs("part " + std::to_string(seen % kMostParts) + " of " + name_ +
                    ": a program sees " + std::to_string(seen / kMostParts) + ", of std's " +
                    std::to_string(stds / kMostParts));
    }
    require(random_.next() == again.next(), "how much was done");
    spoil(c.real());
  }

  void spoil(D<Shm>& document) {
    auto& first = std::get<0>(document.parts());
    if (!first.empty() && planted("letter")) first.pop_back();
  }

  void locate(const D<Shm>& document, bool at_home, std::vector<Located>& all) {
    Participant& p = place_.at(&document);
    segment::Segment& s = p.segment();
    const std::uint32_t block = block_of(s, document);
    const Pieces pieces = pieces_of(document);
    for (const Piece& piece : pieces) {
      const std::uint64_t begin = s.offset_of(piece.begin);
      const auto named = [&] {
        return std::to_string(piece.bytes) + " bytes at " + std::to_string(begin) + ", part " +
               std::to_string(piece.part) + " of " + name_ + " in block " + std::to_string(block) +
               (at_home ? "" : ", taken");
      };
      if (reinterpret_cast<std::uintptr_t>(piece.begin) % piece.align != 0) {
        throw Differs("a piece is not aligned: " + named());
      }
      if (!s.holds(block, begin, piece.bytes)) {
        throw Differs("a piece does not lie in the memory of its message: " + named());
      }
      all.push_back({begin, begin + piece.bytes});
    }
    if (counts_) count(s, block, at_home, pieces);
  }

  std::uint32_t block_of(segment::Segment& s, const D<Shm>& document) const {
    if (const auto* arena = std::get<0>(document.parts()).get_allocator().arena()) {
      return s.block_of(*arena);
    }
    throw Differs("a container of a message belongs to none");
  }

  /// Each extent says how many pieces live in it. (The home's own words say it; of a message that
  /// another participant has taken, the arena.)
  void count(segment::Segment& s, std::uint32_t block, bool at_home, const Pieces& pieces) {
    const Build& build = s.build(block);
    const Arena& arena = s.arena(block);
    const unsigned extents = at_home ? build.extents : arena.count();
    for (unsigned i = 0; i < extents; ++i) {
      const Arena::Extent& extent = at_home ? build.extent[i] : arena.extent[i];
      const unsigned char* const begin = s.base() + s.granule_offset(extent.granule);
      const unsigned char* const end = begin + kGranule * extent.granules;
      const auto living = std::count_if(pieces.begin(), pieces.end(), [&](const Piece& piece) {
        return piece.begin >= begin && piece.begin < end;
      });
      constexpr std::uint16_t kTooMany = 0xffff;  // it has counted up to there, and counts no more
      if (extent.living != kTooMany && living != extent.living) {
        throw Differs("an extent of " + name_ + " has " + std::to_string(living) +
                      " pieces, and says " + std::to_string(extent.living));
      }
    }
  }

  Place& place_;
  const std::string name_;
  const bool counts_;
  Random& random_;
  ShmPusher<D<Shm>> pusher_;
  ShmPuller<D<Shm>> puller_;
  std::array<Items, 2> there_, back_;
  std::array<Case<D>, 4> cases_;
};

class Model {
 public:
  explicit Model(Run& run)
      : notes_(std::in_place, place_, "notes", true, run.random()),
        documents_(std::in_place, place_, "documents", true, run.random()),
        heaps_(std::in_place, place_, "heaps", false, run.random()),
        random_(run.random()) {}

  void step(unsigned) {
    switch (random_.below(6)) {
      case 0:
      case 1:
        notes_->step();
        break;
      case 2:
        heaps_->step();
        break;
      default:
        documents_->step();
    }
    check_places();
  }

  /// All documents, also those that no step has touched; and in the end nothing.
  void end() {
    notes_->compare();
    documents_->compare();
    heaps_->compare();
    notes_.reset();
    documents_.reset();
    heaps_.reset();
    require(
        testing::eventually([this] { return place_.audit().nothing(); }, std::chrono::seconds(20)),
        "what is left in the end: " + place_.audit().text());
  }

 private:
  void check_places() {
    all_.clear();
    notes_->locate(all_);
    documents_->locate(all_);
    heaps_->locate(all_);
    std::sort(all_.begin(), all_.end(),
              [](const Located& a, const Located& b) { return a.begin < b.begin; });
    const auto overlap =
        std::adjacent_find(all_.begin(), all_.end(),
                           [](const Located& a, const Located& b) { return b.begin < a.end; });
    require(overlap == all_.end(), "no piece overlaps another one");
  }

  Place place_;
  std::optional<Gallery<Note>> notes_;
  std::optional<Gallery<Document>> documents_;
  std::optional<Gallery<Heap>> heaps_;
  Random& random_;
  std::vector<Located> all_;
};

int main(int argc, char** argv) {
  Run run(argc, argv, 4000, kMistakes);
  testing::prefix();
  const bool has_janitor = testing::start_janitor();
  require(has_janitor, "a janitor");
  for (const Mistake& m : kMistakes) {
    if (run.planted(m.name)) plant = m.name;
  }
  return run_model<Model>(run);
}

}  // namespace
}  // namespace lot::outside

// The linker (--wrap) sends the test's own calls to the second of each pair.

void real_deallocate(lot::detail::Arena*, void*,
                     std::size_t) asm("__real__ZN3lot6detail5Arena10deallocateEPvm");
void wrap_deallocate(lot::detail::Arena*, void*,
                     std::size_t) asm("__wrap__ZN3lot6detail5Arena10deallocateEPvm");
void wrap_deallocate(lot::detail::Arena* arena, void* piece, std::size_t bytes) {
  using lot::outside::planted;
  if (planted("forget")) return;
  real_deallocate(arena, piece, bytes);
  lot::detail::Build* const build = lot::detail::Build::of(*arena);
  if (planted("merge") && build->cursor > build->mapping->small_of(arena) + 200) build->cursor -= 8;
  if (planted("stale")) (void)*static_cast<volatile unsigned char*>(piece);
}

void* real_find_room(lot::detail::Build*, std::size_t,
                     std::size_t) asm("__real__ZN3lot6detail5Build9find_roomEmm");
void* wrap_find_room(lot::detail::Build*, std::size_t,
                     std::size_t) asm("__wrap__ZN3lot6detail5Build9find_roomEmm");
void* wrap_find_room(lot::detail::Build* build, std::size_t bytes, std::size_t align) {
  using lot::outside::planted;
  static void* last = nullptr;
  static std::size_t last_bytes = 0;
  if (bytes <= last_bytes && planted("twice")) return last;
  if (planted("short")) return real_find_room(build, bytes / 2, align);
  if (align >= 8 && planted("askew")) {
    return static_cast<unsigned char*>(real_find_room(build, bytes + 4, align)) + 4;
  }
  last = real_find_room(build, bytes, align);
  last_bytes = bytes;
  return last;
}

int main(int argc, char** argv) { return lot::outside::main(argc, argv); }
