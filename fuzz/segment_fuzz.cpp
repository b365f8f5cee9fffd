// SPDX-License-Identifier: Apache-2.0

// Joins a segment whose bytes were changed, and uses it: an error or ordinary behaviour, never a
// crash, a hang, or an access outside of the segment or in a free granule.
//
// The segment is one that three processes have left by being killed: topics, rings, messages that
// are queued, borrowed, kept, referred to and forwarded. The input is a list of edits to it and
// then a list of operations.
//
// Input: flags, truncation | number of edits, edits of 8 bytes | operations
// (corpus/segment/ has examples)

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <iterator>
#include <memory>
#include <optional>
#include <string>
#include <sys/stat.h>
#include <type_traits>
#include <unistd.h>
#include <utility>
#include <vector>

#include "lot/fuzz.hpp"

#include "liveness/lock_file.hpp"
#include "support/directory.hpp"
#include "support/must_go.hpp"
#include "support/plant.hpp"
#include "support/window.hpp"
#include "transport/participant.hpp"

namespace {

using lot::fuzz::Bytes;
using lot::fuzz::planted;
using lot::fuzz::require;
using lot::testing::Child;
using lot::testing::must;
using lot::testing::must_go;
using lot::testing::Steps;
namespace window = lot::fuzz::window;
using namespace std::chrono_literals;

struct Small {
  std::uint64_t number;
  std::uint32_t bytes[4];
};
struct Large {
  std::array<std::uint8_t, 9000> bytes;
};
struct Document {
  lot::ShmString title;
  lot::ShmVector<std::uint32_t> numbers;
  lot::ShmVector<lot::ShmString> lines;
  lot::ShmRef<const Small> small;
  lot::ShmVector<lot::ShmRef<const Large>> larges;
};

volatile unsigned sink;  ///< what is read is used

// ---- the segment that is left
// ---------------------------------------------------------------------------

lot::EngineOptions options(const std::string& directory) {
  lot::EngineOptions options;
  options.segment = "left";
  options.directory = directory;
  options.size_bytes = 6 << 20;
  options.processes = 7;
  options.blocks = 48;
  options.topics = 6;
  options.channels = 8;
  options.readers = 4;
  return options;
}

void fill(Document& d, unsigned n) {
  d.title = "a title that does not fit into the string itself";
  d.numbers.resize(2000 + 100 * n);
  d.lines.resize(3);
  for (auto& line : d.lines) line = "a line that does not fit into the string itself either";
}

// What the three processes do before they are killed.

void read_and_keep(const lot::EngineOptions& options, const Steps& go, const Steps& done) {
  lot::ShmEngine engine(options);
  done.tell();
  must(go.next() != 0, "there are publishers");
  auto smalls = engine.subscribe<Small>("/small", {lot::Wait::Park, 3});
  auto documents = engine.subscribe<Document>("/document", {lot::Wait::Park, 3});
  auto larges = engine.subscribe<Large>("/large", {lot::Wait::Park, 3});
  done.tell();
  must(go.next() != 0, "all is published");
  const auto kept = documents.pull(10s);
  const auto borrowed = documents.borrow(10s);
  const auto kept_large = larges.pull(10s);
  const auto borrowed_small = smalls.borrow(10s);
  must(kept && borrowed && kept_large && borrowed_small, "all is read");
  done.tell();
  pause();
}

void publish(const lot::EngineOptions& options, const Steps& done) {
  lot::ShmEngine engine(options);
  auto smalls = engine.advertise<Small>("/small", {lot::Policy::Overwrite, 4});
  auto documents = engine.advertise<Document>("/document", {lot::Policy::Block, 5});
  auto larges = engine.advertise<Large>("/large", {lot::Policy::Overwrite, 3});
  for (unsigned n = 0; n < 6; ++n) must_go(smalls.push(smalls.loan()));
  const lot::ShmSharedPtr<Small> small = engine.make<Small>();
  const lot::ShmSharedPtr<Large> large = larges.loan();
  must_go(smalls.push(small));
  must_go(larges.push(large));
  must_go(larges.push(larges.loan()));
  for (unsigned n = 0; n < 4; ++n) {
    auto document = documents.loan();
    fill(*document, n);
    document->small = small;
    document->larges.resize(n);
    for (auto& l : document->larges) l = large;
    must_go(documents.push(std::move(document)));
  }
  auto unfinished = documents.loan();
  fill(*unfinished, 9);
  done.tell();
  pause();
}

/// Its ring is closed, and still has a reader.
void publish_and_close(const lot::EngineOptions& options, const Steps& done) {
  lot::ShmEngine engine(options);
  {
    auto documents = engine.advertise<Document>("/document", {lot::Policy::Overwrite, 4});
    done.tell();
    must(documents.wait_for_readers(1, 10s), "somebody reads");
    for (unsigned n = 0; n < 3; ++n) {
      auto document = documents.loan();
      fill(*document, n);
      must_go(documents.push(std::move(document)));
    }
  }
  done.tell();
  pause();
}

/// The segment's bytes, and where the target works.
class Base {
 public:
  static constexpr std::size_t kPage = 4096;

  Base() : directory_(), options_(options(directory_.path())) {
    Steps go;
    Steps done;
    // By index: 1 reads, 2 publishes, 3 has closed a ring.
    Child reader([&] { read_and_keep(options_, go, done); });
    must(done.next() != 0, "the reader has come");
    Child publisher([&] { publish(options_, done); });
    must(done.next() != 0, "all is published");
    Child closer([&] { publish_and_close(options_, done); });
    must(done.next() != 0, "the other publisher has come");
    go.tell();
    must(done.next() != 0, "the reader has subscribed");
    must(done.next() != 0, "a ring is closed");
    go.tell();
    must(done.next() != 0, "all is read");
    for (Child* child : {&reader, &publisher, &closer}) child->kill9();
    std::ifstream file(path(), std::ios::binary);
    bytes_.resize(options_.size_bytes);
    file.read(reinterpret_cast<char*>(bytes_.data()), static_cast<std::streamsize>(bytes_.size()));
    must(file.good(), "what is left is read");
    remove();
    for (std::size_t at = 0; at < bytes_.size(); at += kPage) {
      const auto* page = bytes_.data() + at;
      if (std::any_of(page, page + kPage, [](unsigned char b) { return b != 0; }))
        pages_.push_back(at);
    }
    window::install();
  }

  const lot::EngineOptions& engine_options() const { return options_; }
  std::string path() const { return options_.directory + "/" + options_.segment; }
  const std::vector<unsigned char>& bytes() const { return bytes_; }
  /// Where there is something but zeros.
  const std::vector<std::size_t>& pages() const { return pages_; }
  const lot::segment::Header& header() const {
    return *reinterpret_cast<const lot::segment::Header*>(bytes_.data());
  }

  void remove() const {
    ::unlink(path().c_str());
    ::unlink((path() + ".new").c_str());
    ::unlink((path() + ".lock").c_str());
  }

 private:
  lot::fuzz::Directory directory_;
  lot::EngineOptions options_;
  std::vector<unsigned char> bytes_;
  std::vector<std::size_t> pages_;
};

// ---- edits
// ------------------------------------------------------------------------------------------------

/// Changes the bytes of a segment, mostly in the tables and where they lead.
class Editor {
 public:
  explicit Editor(const Base& base)
      : bytes_(base.bytes()),
        capacity_(base.header().capacity),
        geometry_(lot::segment::Geometry::of(capacity_)),
        file_(open(base.path().c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600)) {
    require(file_ != -1 && ftruncate(file_, static_cast<off_t>(bytes_.size())) == 0,
            "a file is made");
    for (const std::size_t at : base.pages()) write(at, bytes_.data() + at, Base::kPage);
  }
  ~Editor() { close(file_); }
  Editor(const Editor&) = delete;
  Editor& operator=(const Editor&) = delete;

  /// An edit is: area, index, offset (2), operation, value (3).
  void edit(Bytes& input) {
    const std::uint8_t area = input.byte();
    const std::uint8_t index = input.byte();
    const auto offset = input.number<std::uint16_t>();
    const std::uint8_t operation = input.byte();
    const std::uint32_t value = std::uint32_t{input.number<std::uint16_t>()} << 8 | input.byte();
    change(place(area < 252 ? area % 14 : 14, index, offset), operation, value);
  }

  /// Leaves so many 65536ths of the file.
  void truncate(std::uint64_t part) const {
    require(ftruncate(file_, static_cast<off_t>(bytes_.size() * part >> 16)) == 0,
            "it is truncated");
  }

 private:
  void write(std::uint64_t at, const void* from, std::size_t bytes) const {
    require(pwrite(file_, from, bytes, static_cast<off_t>(at)) == static_cast<ssize_t>(bytes),
            "it is written");
  }

  std::uint64_t place(unsigned area, std::uint64_t index, std::uint64_t offset) const {
    using namespace lot::segment;
    const auto entry = [&](std::uint64_t table, std::uint64_t count, std::uint64_t size) {
      return table + index % count * size + offset % size;
    };
    switch (area) {
      case 0:
        return offset % sizeof(Header);
      case 1:
        return entry(geometry_.participants, capacity_.participants, sizeof(ParticipantEntry));
      case 2:
        return entry(geometry_.witnesses, capacity_.participants, sizeof(Witness));
      case 3:
        return entry(geometry_.directory, 1, sizeof(Directory));
      case 4:
        return entry(geometry_.topics, capacity_.topics, sizeof(TopicEntry));
      case 5:
      case 6:
        return entry(geometry_.channels, capacity_.channels, sizeof(ChannelEntry));
      case 7:
      case 8:
        return entry(geometry_.blocks, capacity_.blocks, sizeof(BlockWords));
      case 9:
        return entry(geometry_.arenas, capacity_.blocks, sizeof(lot::detail::Arena));
      case 10:
        return entry(geometry_.tags, geometry_.granules, sizeof(Tag)) + index * 16 % 1024;
      case 11: {  // a ring's memory
        const ChannelEntry& channel = at<ChannelEntry>(
            geometry_.channels + index % capacity_.channels * sizeof(ChannelEntry));
        return geometry_.data + channel.granule * kGranule +
               offset % (kGranule * (1 + channel.granules % 16));
      }
      case 12:
        return entry(geometry_.small, capacity_.blocks, kSmallBytes);
      case 14:
        return entry(geometry_.replies, capacity_.topics, sizeof(Replies));
      default: {  // a message's memory
        const auto& arena = at<lot::detail::Arena>(
            geometry_.arenas + index % capacity_.blocks * sizeof(lot::detail::Arena));
        return geometry_.data + arena.extent[0].granule * kGranule + offset % kGranule;
      }
    }
  }

  template <class T>
  const T& at(std::uint64_t offset) const {
    return *reinterpret_cast<const T*>(bytes_.data() + offset);
  }

  /// Values that mean something, and any others.
  std::uint64_t value_of(std::uint8_t kind, std::uint32_t given) const {
    using namespace lot::segment;
    switch (kind / 8 % 16) {
      case 0:
        return ~std::uint64_t{0};
      case 1:
        return capacity_.blocks - 1 + given % 3;
      case 2:
        return geometry_.granules - 1 + given % 3;
      case 3:
        return capacity_.size - given % 512;
      case 4:
        return std::uint64_t{given} << (given % 40);
      case 5:
        return geometry_.data + given * 8;
      case 6:
        return geometry_.small + given % (capacity_.blocks * kSmallBytes);
      case 7:
        return kRingTag | given % capacity_.channels;
      case 8:
        return std::uint64_t{1} << (given % 64);
      default:
        return given;
    }
  }

  void change(std::uint64_t place, std::uint8_t kind, std::uint32_t given) {
    const std::uint64_t value = value_of(kind, given);
    const unsigned width = 1U << (kind % 4);
    place = std::min<std::uint64_t>(place / width * width, bytes_.size() - 8);
    std::uint64_t word = 0;
    require(pread(file_, &word, width, static_cast<off_t>(place)) == width, "it is read");
    if (kind / 128 != 0) {
      word += value;
    } else if ((kind & 4) != 0) {
      word ^= value;
    } else {
      word = value;
    }
    write(place, &word, width);
    using lot::segment::Header;
    if (place >= offsetof(Header, capacity) && place < offsetof(Header, check)) seal();
  }

  /// A damaged capacity would be refused for its check alone: one who means it writes that as well.
  void seal() const {
    lot::segment::Header header;
    require(pread(file_, &header, sizeof(header), 0) == sizeof(header), "its header is read");
    header.check = lot::segment::check_of(header.capacity);
    write(0, &header, sizeof(header));
  }

  const std::vector<unsigned char>& bytes_;  ///< before any edit
  lot::segment::Capacity capacity_;
  lot::segment::Geometry geometry_;
  int file_;
};

// ---- use
// --------------------------------------------------------------------------------------------------

// What a message says about its own memory is not checked by the library, and whether it is still
// its own neither, when ownership words lie: so it is looked at here before it is read. That a
// message lies in the segment is the library's promise.

template <class Element>
bool is_readable(const Element* data, std::size_t count) {
  return count <= window::size() &&
         reinterpret_cast<std::uintptr_t>(data) % alignof(Element) == 0 &&
         window::is_usable(data, count * sizeof(Element));
}
/// Calls use(element) for what was looked at, and no more: a damaged vector's end may lie between
/// two elements, and a loop from its begin to its end would run past it.
template <class Container, class Use>
void each_readable(const Container& container, Use use) {
  const auto* const data = container.data();
  const std::size_t count = container.size();
  if (!is_readable(data, count)) return;
  for (std::size_t i = 0; i < count; ++i) use(data[i]);
}

void read(const Small& small) {
  sink = sink + small.bytes[3] + static_cast<unsigned>(small.number);
}
void read(const Large& large) {
  for (const auto byte : large.bytes) sink = sink + byte;
}
template <class Container>
void read_all(const Container& container) {
  each_readable(container, [](auto element) { sink = sink + static_cast<unsigned>(element); });
}
template <class T>
void read_message(const T* message) {
  const auto* place = reinterpret_cast<const unsigned char*>(message);
  require(place >= window::base() && place + sizeof(T) <= window::base() + window::size(),
          "a message lies in the segment");
  if (is_readable(message, 1)) read(*message);
}
/// Of a message that travels in a slot a reader borrows a copy, which lies elsewhere.
template <class T>
void read_borrowed(const T* message) {
  const auto* place = reinterpret_cast<const unsigned char*>(message);
  const bool is_inside = place >= window::base() && place < window::base() + window::size();
  if (!std::is_same_v<T, Small> || is_inside) return read_message(message);
  read(*message);
}
template <class T>
void read_reference(const lot::ShmRef<const T>& reference) {
  try {
    const auto target = reference.lock();
    if (target) read_message(target.get());
  } catch (const lot::Error&) {
  }
}
void read(const Document& document) {
  read_all(document.title);
  read_all(document.numbers);
  each_readable(document.lines, [](const auto& line) { read_all(line); });
  read_reference(document.small);
  each_readable(document.larges, [](const auto& large) { read_reference(large); });
}

/// All that one process does with the messages of one type.
template <class T>
class Station {
 public:
  Station(lot::ShmEngine& engine, const char* topic) : engine_(engine), topic_(topic) {}

  void step(unsigned operation, Bytes& input) {
    const std::size_t which = input.byte();
    switch (operation) {
      case 0: {
        lot::PusherOptions how{which % 2 == 0 ? lot::Policy::Overwrite : lot::Policy::Block,
                               static_cast<std::uint32_t>(1 + which / 2 % 4)};
        pusher_.reset();
        pusher_.emplace(engine_.advertise<T>(topic_, how));
        return;
      }
      case 1: {
        constexpr std::uint64_t kHistory[] = {0, 1, 100, ~std::uint64_t{0}};
        constexpr lot::Wait kWait[] = {lot::Wait::Park, lot::Wait::Adaptive};
        end_reading();
        puller_.emplace(engine_.subscribe<T>(topic_, {kWait[which / 4 % 2], kHistory[which % 4]}));
        return;
      }
      case 2:
        if (pusher_) push();
        return;
      case 3:
        if (puller_ && !borrow_) keep(which % 2 == 0 ? puller_->try_pull() : puller_->pull(1ms));
        return;
      case 4:
        if (puller_) {
          borrow_.end();
          borrow_ = puller_->try_borrow();
          if (borrow_) read_borrowed(borrow_.get());
        }
        return;
      case 5:
        if (borrow_) keep(borrow_.keep());
        borrow_.end();
        return;
      case 6:
        // Full as well: the segment is damaged.
        if (pusher_ && !kept_.empty()) (void)pusher_->push(kept_[which % kept_.size()], 0ms);
        return;
      case 7:
        if (!kept_.empty())
          kept_.erase(kept_.begin() + static_cast<std::ptrdiff_t>(which % kept_.size()));
        return;
      case 8:
        for (const auto& message : kept_) {
          read_message(message.get());
          sink = sink + static_cast<unsigned>(message.use_count());
        }
        return;
      case 9:
        if (!kept_.empty()) {
          const lot::ShmWeakPtr<const T> weak(kept_.back());
          kept_.pop_back();
          keep(weak.lock());
        }
        return;
      case 10:
        pusher_.reset();
        return;
      case 11:
        return end_reading();
    }
  }

 private:
  void keep(lot::ShmSharedPtr<const T> message) {
    if (!message) return;
    read_message(message.get());
    if (kept_.size() == 8) kept_.erase(kept_.begin());
    kept_.push_back(std::move(message));
  }
  void push() {
    auto message = pusher_->loan();
    if constexpr (std::is_same_v<T, Document>) fill(*message, 1);
    (void)pusher_->push(std::move(message), 1ms);  // Full as well: the segment is damaged
    sink = sink + static_cast<unsigned>(pusher_->readers());
  }
  void end_reading() {
    borrow_.end();
    puller_.reset();
  }

  lot::ShmEngine& engine_;
  const char* topic_;
  std::optional<lot::ShmPusher<T>> pusher_;
  std::optional<lot::ShmPuller<T>> puller_;
  lot::ShmBorrow<T> borrow_;
  std::vector<lot::ShmSharedPtr<const T>> kept_;
};

void use(const lot::EngineOptions& options, Bytes& input) {
  lot::ShmEngine engine(options);
  const auto participant = lot::detail::join(options);
  Station<Small> smalls(engine, "/small");
  Station<Document> documents(engine, "/document");
  Station<Large> larges(engine, "/large");
  while (input.left() != 0) {
    window::poison_free_granules();
    const unsigned operation = input.byte();
    try {
      switch (operation / 16 % 4) {
        case 0:
          smalls.step(operation % 16, input);
          break;
        case 1:
          documents.step(operation % 16, input);
          break;
        case 2:
          larges.step(operation % 16, input);
          break;
        default:
          if (operation % 2 == 0) participant->reaper().reap_dead();
          participant->reaper().collect();
      }
    } catch (const lot::Error&) {
    } catch (const lot::OutOfMemory&) {
    }
    if (planted("outside")) sink = sink + window::base()[window::size() + 8];
    if (planted("free_granule")) sink = sink + window::base()[window::size() - 8];
    if (planted("hang")) pause();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto* const base = new Base;
  Bytes input(data, size);
  const std::uint8_t flags = input.byte();
  const auto rest = input.number<std::uint16_t>();
  {
    Editor editor(*base);
    for (std::size_t n = input.below(16); n > 0; --n) editor.edit(input);
    if ((flags & 1) != 0) editor.truncate(rest);
  }
  const std::string path = base->path();
  {
    // Some of the dead may look alive: somebody holds their locks.
    std::optional<lot::liveness::LockFile> others;
    if ((flags & 6) != 0) others.emplace(path + ".lock");
    if ((flags & 2) != 0) others->try_lock(2);
    if ((flags & 4) != 0) others->try_lock(3);
    try {
      use(base->engine_options(), input);
    } catch (const lot::Error&) {
    } catch (const lot::OutOfMemory&) {
    }
  }
  require(window::base() == nullptr, "the segment is unmapped");
  base->remove();
  return 0;
}
