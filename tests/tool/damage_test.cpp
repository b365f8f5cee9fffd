// SPDX-License-Identifier: Apache-2.0

// Segments whose bytes were changed at random: the tool says what is wrong, and never crashes,
// hangs or reads outside of the segment.
//
// It is looked at in this process, between areas that nobody may touch and with poison on the
// memory that nobody owns, and by the command itself.

#include <cctype>
#include <cstddef>
#include <cstring>
#include <fcntl.h>
#include <optional>
#include <random>
#include <string>
#include <sys/stat.h>
#include <vector>

#include <doctest/doctest.h>

#include "actor.hpp"
#include "command.hpp"
#include "robust_mutex/lock_word.hpp"
#include "support/janitor.hpp"
#include "support/window.hpp"
#include "tool/rates.hpp"
#include "tool/sight.hpp"

namespace {

using namespace lot::testing;
using lot::segment::Geometry;

[[maybe_unused]] const bool has_janitor = start_janitor();

/// What is left when a publisher and a reader are killed that have done everything.
std::string make_image() {
  const Room room;
  const auto options = room.options();
  Actor publisher(options, "publisher");
  Actor reader(options, "reader");
  Actor closer(options, "closer");
  for (const char* topic : {kLetters, kParcels}) {
    publisher.act(topic, "advertise", 1);
    closer.act(topic, "advertise", 2);
    reader.act(topic, "subscribe");
    for (int n = 0; n < 6; ++n) {
      for (Actor* actor : {&publisher, &closer}) {
        actor->act(topic, "loan");
        actor->act(topic, "push");
      }
      if (n < 2) reader.act(topic, "pull");
      if (n == 2) reader.act(topic, "borrow");
    }
    publisher.act(topic, "loan");
  }
  closer.act(kLetters, "unadvertise");  // an orphaned queue
  stop(closer.child());
  stop(reader.child());
  publisher.kill9();
  return bytes_of(options.directory + "/" + options.segment);
}

class Damager {
 public:
  Damager(std::string image, std::uint64_t seed) : image_(std::move(image)), random_(seed) {
    std::memcpy(&capacity_, image_.data() + offsetof(lot::segment::Header, capacity),
                sizeof(capacity_));
    geometry_ = Geometry::of(capacity_);
  }

  /// The image with some of its words changed.
  std::string damaged() {
    std::string bytes = image_;
    for (std::uint64_t n = 1 + below(6); n > 0; --n) change(bytes);
    if (below(10) == 0) bytes.resize(below(bytes.size()));
    return bytes;
  }

 private:
  std::uint64_t below(std::uint64_t n) { return n == 0 ? 0 : random_() % n; }

  /// A place that means something: in a table's first entries, where something is, or a ring.
  std::uint64_t place() {
    using namespace lot::segment;
    const auto entry = [&](std::uint64_t table, std::uint64_t count, std::uint64_t size) {
      return table + below(std::min<std::uint64_t>(count, 12)) * size + below(size);
    };
    switch (below(12)) {
      case 0:
        return below(sizeof(Header));
      case 1:
        return entry(geometry_.participants, capacity_.participants, sizeof(ParticipantEntry));
      case 2:
        return entry(geometry_.witnesses, capacity_.participants, sizeof(Witness));
      case 3:
        return entry(geometry_.topics, capacity_.topics, sizeof(TopicEntry));
      case 4:
      case 5:
        return entry(geometry_.channels, capacity_.channels, sizeof(ChannelEntry));
      case 6:
        return geometry_.blocks + below(capacity_.blocks * sizeof(BlockWords));
      case 7:
        return geometry_.arenas + below(capacity_.blocks * sizeof(lot::detail::Arena));
      case 8:
        return geometry_.tags + below(geometry_.granules * sizeof(Tag));
      case 9:
        return entry(geometry_.sightings, capacity_.participants, sizeof(Sightings));
      case 10:
        return entry(geometry_.replies, capacity_.topics, sizeof(Replies));
      default: {
        std::uint32_t granule = 0;
        std::memcpy(&granule,
                    image_.data() + geometry_.channels + below(4) * sizeof(ChannelEntry) +
                        offsetof(ChannelEntry, granule),
                    sizeof(granule));
        return geometry_.data + granule * kGranule + below(kGranule);
      }
    }
  }

  std::uint64_t value() {
    switch (below(8)) {
      case 0:
        return 0;
      case 1:
        return ~std::uint64_t{0};
      case 2:
        return capacity_.blocks - 1 + below(3);
      case 3:
        return geometry_.granules - 1 + below(3);
      case 4:
        return image_.size() - below(512);
      case 5:
        return lot::segment::kRingTag | below(capacity_.channels + 1);
      case 6:
        return std::uint64_t{1} << below(64);
      default:
        return random_();
    }
  }

  void change(std::string& bytes) {
    const std::uint64_t width = std::uint64_t{1} << below(4);
    const std::uint64_t at = std::min<std::uint64_t>(place() / width * width, bytes.size() - 8);
    std::uint64_t word = 0;
    std::memcpy(&word, bytes.data() + at, width);
    const std::uint64_t v = value();
    word = below(3) == 0 ? word ^ v : below(2) == 0 ? word + v : v;
    std::memcpy(bytes.data() + at, &word, width);
  }

  std::string image_;
  std::mt19937_64 random_;
  lot::segment::Capacity capacity_;
  Geometry geometry_{};
};

void write_to(const std::string& path, const std::string& bytes) {
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  REQUIRE(file.good());
  REQUIRE(chmod(path.c_str(), 0600) == 0);  // else it is not trusted
}

/// Made once, before the window is there: that is not for segments of several processes.
const std::string& image() {
  static const std::string made = make_image();
  return made;
}

}  // namespace

TEST_SUITE_BEGIN("damage");

TEST_CASE("a segment with changed words is looked at without a step outside of it") {
  const Watchdog watchdog(120);
  Damager damager(image(), seed());
  lot::fuzz::window::install();
  const Room room;
  const std::string path = room.path() + "/s";
  unsigned mapped = 0;
  unsigned complaints = 0;
  for (unsigned n = 0; n < 1000; ++n) {
    CAPTURE(n);
    write_to(path, damager.damaged());
    lot::tool::Sight sight = lot::tool::sight({room.path(), "", {}}, "s");
    if (sight.window == nullptr) {
      CHECK(!sight.reason.empty());
      continue;
    }
    ++mapped;
    REQUIRE(lot::fuzz::window::base() != nullptr);
    const auto seen = lot::tool::observe(*sight.window);
    complaints += !seen.damage.empty();
    CHECK(seen.messages.size() <= 512);
    lot::tool::RateMeter meter(*sight.window);
    meter.look();
    (void)meter.rates();
    const auto living = lot::tool::living(*sight.window);
    CHECK(living.size() + lot::tool::dead(*sight.window).size() <= 7);
  }
  std::printf("%u could be mapped, %u had something wrong inside\n", mapped, complaints);
  CHECK(mapped != 0);
  CHECK(mapped != 1500);
  CHECK(complaints != 0);
}

TEST_CASE("no process has come before it could, or after now") {
  const Watchdog watchdog(60);
  const std::string sound = image();
  lot::segment::Capacity capacity;
  std::memcpy(&capacity, sound.data() + offsetof(lot::segment::Header, capacity), sizeof(capacity));
  const std::uint64_t table = Geometry::of(capacity).participants;
  const Room room;
  for (const std::uint64_t since : {std::uint64_t{1} << 63, std::uint64_t{11019016721167867844U},
                                    ~std::uint64_t{0}, std::uint64_t{1} << 62}) {
    CAPTURE(since);
    std::string bytes = sound;
    for (std::uint32_t k = 1; k < capacity.participants; ++k) {
      bytes.replace(table + k * sizeof(lot::segment::ParticipantEntry) +
                        offsetof(lot::segment::ParticipantEntry, since_ns),
                    sizeof(since), reinterpret_cast<const char*>(&since), sizeof(since));
    }
    write_to(room.path() + "/s", bytes);
    const Ran ran = run_lot({"ls", "--dir", room.path()});
    CAPTURE(ran.out);
    CHECK(ran.err == "");
    CHECK(ran.out.find("publisher") != std::string::npos);
    for (std::size_t at = 0; (at = ran.out.find('-', at)) != std::string::npos; ++at) {
      CHECK(std::isdigit(static_cast<unsigned char>(ran.out[at + 1])) == 0);
    }
  }
}

TEST_CASE("the command ends with 0, 1 or 3 and a whole document, whatever the segment is") {
  const Watchdog watchdog(300);
  Damager damager(image(), seed() + 1);
  const Room room;
  for (unsigned n = 0; n < 50; ++n) {
    CAPTURE(n);
    write_to(room.path() + "/s", damager.damaged());
    for (const char* command : {"ls", "top", "who", "doctor", "clean"}) {
      CAPTURE(command);
      std::vector<std::string> words = {command, "--json", "--dir", room.path()};
      if (std::string(command) == "who") words.push_back("--all");
      if (std::string(command) == "ls" || std::string(command) == "top") {
        words.insert(words.end(), {"--interval", "1"});
      }
      const Ran ran = run_lot(words);
      CAPTURE(ran.err);
      CHECK((ran.exit == 0 || ran.exit == 1 || ran.exit == 3));
      CHECK(ran.json().at("exit") == ran.exit);
      words[1] = "--dry-run";
      if (std::string(command) == "clean") continue;
      words.erase(words.begin() + 1);
      CHECK(run_lot(words).exit == ran.exit);
    }
  }
}

TEST_CASE("each kind of damage is named") {
  const Watchdog watchdog(120);
  const Room room;
  lot::segment::Capacity capacity;
  std::memcpy(&capacity, image().data() + offsetof(lot::segment::Header, capacity),
              sizeof(capacity));
  const auto geometry = Geometry::of(capacity);
  const auto said = [&](std::uint64_t at, std::uint32_t value) {
    std::string bytes = image();
    std::memcpy(bytes.data() + at, &value, sizeof(value));
    write_to(room.path() + "/s", bytes);
    const Ran ran = run_lot({"ls", "--interval", "1", "--dir", room.path()});
    CHECK(ran.exit == 3);
    return ran.out;
  };
  const auto place_of_ring = [&](std::uint32_t channel) {
    std::uint32_t granule = 0;
    std::memcpy(&granule,
                image().data() + geometry.channels + channel * sizeof(lot::segment::ChannelEntry) +
                    offsetof(lot::segment::ChannelEntry, granule),
                sizeof(granule));
    return geometry.data + granule * lot::segment::kGranule;
  };
  const auto says = [](const std::string& text, const char* part) {
    return text.find(part) != text.npos;
  };
  using lot::segment::ChannelEntry;
  CHECK(says(said(8, 77), "it has layout version 77"));
  CHECK(says(said(16, 77), "it was made by a build with other word sizes"));
  CHECK(says(said(72 + 8, 0), "its header is damaged"));
  CHECK(says(said(geometry.directory + offsetof(lot::segment::Directory, lock), 400),
             "the lock of the registry: its holder can not be"));
  CHECK(says(said(geometry.directory + offsetof(lot::segment::Directory, lock),
                  lot::lock::make_name(capacity.participants, 0)),
             "the lock of the registry: its holder can not be"));
  CHECK(says(said(geometry.participants + 64, 7), "process 1: its state is 7"));
  CHECK(says(said(geometry.channels + offsetof(ChannelEntry, topic), 999), "its topic can not be"));
  CHECK(says(said(geometry.channels + offsetof(ChannelEntry, depth), 1 << 30),
             "its numbers make no sense"));
  CHECK(says(said(geometry.channels, 5000 | 2 << 24), "its publisher can not be"));
  CHECK(says(said(geometry.channels + 3, 77), "its state is 77"));
  const auto ring = place_of_ring(0);
  const std::string forged = said(ring + sizeof(lot::segment::RingHead), 999);
  CHECK(says(forged, "a reader of it can not be"));
  CHECK(!says(forged, "998"));  // nor is it listed
  CHECK(says(said(ring + sizeof(lot::segment::RingHead) + 64, 0x7fff0),
             "a slot of it names a message that can not be"));
  CHECK(says(said(ring + sizeof(lot::segment::RingHead) + 64 + 64, 0x7fff0),
             "borrows a message that can not be"));
  CHECK(says(said(geometry.topics + 32, 1 << 4), "a user 256 can not be"));
  using lot::segment::BlockWords;
  std::uint64_t block = geometry.blocks;
  while (image()[block + offsetof(BlockWords, home)] == 0) block += sizeof(BlockWords);
  CHECK(says(said(block + 32, 1 << 4), "a holder 256 can not be"));
  CHECK(says(said(geometry.tags, 0x7ffffff0), "pieces of memory belong to what can not be"));
  CHECK(says(said(geometry.blocks + offsetof(BlockWords, home), 999), "who made it can not be"));
  write_to(room.path() + "/s", image().substr(0, image().size() / 2));
  CHECK(says(run_lot({"ls", "--dir", room.path()}).out, "its header says"));
  write_to(room.path() + "/s", image().substr(0, 80));
  CHECK(says(run_lot({"ls", "--dir", room.path()}).out, "it is too short"));
}

TEST_CASE("a queue that is half gone while a process has the registry is no damage") {
  using lot::segment::ChannelEntry;
  const Watchdog watchdog(120);
  const Room room;
  lot::segment::Capacity capacity;
  std::memcpy(&capacity, image().data() + offsetof(lot::segment::Header, capacity),
              sizeof(capacity));
  const auto geometry = Geometry::of(capacity);
  std::string bytes = image();
  const auto put = [&bytes](std::uint64_t at, const auto& value) {
    std::memcpy(bytes.data() + at, &value, sizeof(value));
  };
  const auto look = [&] {
    write_to(room.path() + "/s", bytes);
    return run_lot({"ls", "--interval", "1", "--dir", room.path()});
  };
  put(geometry.channels + offsetof(ChannelEntry, depth), std::uint32_t{0});
  put(geometry.channels + offsetof(ChannelEntry, formed), std::uint32_t{0});
  CHECK(look().exit == 3);
  const auto lock = geometry.directory + offsetof(lot::segment::Directory, lock);
  put(lock, lot::lock::make_name(1, 1));
  CHECK(look().exit == 3);  // it is in use, and nobody takes it away
  lot::ring::Word writer = 0;
  std::memcpy(&writer, bytes.data() + geometry.channels, sizeof(writer));
  put(geometry.channels,
      lot::ring::make_writer(lot::ring::writer_generation(writer), lot::ring::State::Orphan,
                             lot::ring::writer_owner(writer)));
  const Ran ran = look();
  CAPTURE(ran.out);
  CHECK(ran.exit == 1);  // its process is dead
  CHECK(ran.out.find("damaged") == ran.out.npos);
  put(lock, std::uint32_t{0});
  CHECK(look().exit == 3);
}

TEST_CASE("a segment that is cut short while it is looked at is said to be so") {
  const Watchdog watchdog(60);
  const Room room;
  const std::string path = room.path() + "/s";
  for (const std::size_t left : {0UL, 4096UL, 100000UL}) {
    CAPTURE(left);
    write_to(path, image());
    lot::tool::Window window(path, {});
    REQUIRE(truncate(path.c_str(), static_cast<off_t>(left)) == 0);
    const auto seen = lot::tool::observe(window);
    CHECK(window.torn());
    REQUIRE(!seen.damage.empty());
    CHECK(seen.damage.back() == "it is shorter than it was when we began to look");
  }
}

TEST_CASE("a segment may be cut short when the one that was opened before it is closed") {
  const Watchdog watchdog(60);
  const Room room;
  const std::string path = room.path() + "/s";
  for (const std::string& file : {path, room.path() + "/older"}) write_to(file, image());
  std::optional<lot::tool::Window> older(std::in_place, room.path() + "/older",
                                         lot::segment::Trust{});
  lot::tool::Window newer(path, {});
  older.reset();
  REQUIRE(truncate(path.c_str(), 4096) == 0);
  (void)lot::tool::observe(newer);
  CHECK(newer.torn());
}

TEST_SUITE_END();
