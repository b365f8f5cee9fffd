// SPDX-License-Identifier: Apache-2.0

// What `lot who` and `lot ls` say is compared with what processes truly hold, after every step.

#include <cstdint>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "actor.hpp"
#include "command.hpp"
#include "support/janitor.hpp"

namespace {

using namespace lot::testing;
using Clock = std::chrono::steady_clock;
using Blocks = std::set<std::uint32_t>;

[[maybe_unused]] const bool has_janitor = start_janitor();

constexpr const char* kTopics[] = {kLetters, kParcels};

double seconds_since(Clock::time_point then) {
  return std::chrono::duration<double>(Clock::now() - then).count();
}

const Json& segment_of(Json&&) = delete;
const Json& segment_of(const Json& document) {
  REQUIRE(document.at("segments").size() == 1);
  return document.at("segments").at(0);
}

/// A random play with several processes, and what must be true of them at every moment.
class Play {
 public:
  explicit Play(std::uint64_t seed) : random_(seed) {
    for (unsigned n = 0; n < 4; ++n) enter();
  }

  void step(unsigned n) {
    const auto before = Clock::now();
    const std::size_t which = random_() % actors_.size();
    const std::string name = std::to_string(actors_[which]->index());
    const std::uint64_t dice = random_() % 40;
    if (n % 40 == 39) {
      last_ = "kill " + name;
      kill(which);
    } else if (dice == 0) {
      last_ = "leave " + name;
      leave(which);
    } else if (dice < 5) {
      fill(*actors_[which], kTopics[random_() % 2]);
    } else {
      act(*actors_[which]);
    }
    look(before);
  }

  /// What the dice may have left out: a reader that borrows, loses, and leaves no room.
  void last_act() {
    const auto before = Clock::now();
    Actor& publisher = *actors_[0];
    Actor& reader = *actors_[1];
    for (const char* topic : kTopics) {
      if (publisher.truth().at(topic).at("publisher").is_null()) {
        publisher.act(topic, "advertise", ++publishers_);
      }
      if (!reader.truth().at(topic).at("subscribed")) {
        begin_reading(reader, topic);
        reader.act(topic, "subscribe");
      }
      for (int n = 0; n < 2; ++n) {  // once more if the first one was of another publisher
        publisher.act(topic, "loan");
        publisher.act(topic, "push");
        find_publishers(reader, topic);
        reader.act(topic, "borrow");
      }
      fill(publisher, topic);
      look(before);
    }
  }

  unsigned kills() const { return kills_; }
  unsigned ages() const { return ages_; }
  unsigned deaths_seen() const { return deaths_seen_; }
  unsigned waits_seen() const { return waits_seen_; }
  unsigned borrows_seen() const { return borrows_seen_; }
  unsigned losses_seen() const { return losses_seen_; }

 private:
  void look(Clock::time_point before) {
    for (const auto& a : actors_) note_held(*a, before);
    INFO("after: " << last_);
    compare();
  }

  void enter() {
    actors_.push_back(std::make_unique<Actor>(options_, "actor" + std::to_string(++entered_)));
    for (const char* topic : kTopics) {
      begin_reading(*actors_.back(), topic);
      actors_.back()->act(topic, "subscribe");
    }
    actors_.back()->act(kTopics[random_() % 2], "advertise", ++publishers_);
  }

  void act(Actor& actor) {
    static constexpr const char* kActs[] = {"advertise", "subscribe", "leave topic", "loan", "loan",
                                            "loan",      "push",      "push",        "push", "push",
                                            "pull",      "pull",      "pull",        "end",  "keep",
                                            "borrow",    "borrow",    "release",     "drop"};
    const char* const topic = kTopics[random_() % 2];
    std::string what = kActs[random_() % std::size(kActs)];
    const Json& truth = actor.truth().at(topic);
    // One that is there stays a while.
    const bool has_publisher = !truth.at("publisher").is_null();
    if (what == "leave topic") what = random_() % 2 == 0 ? "unadvertise" : "unsubscribe";
    if (what.starts_with("un") && random_() % 4 != 0) what = "borrow";
    if (what == "advertise" && has_publisher) what = "push";
    if (what == "subscribe" && truth.at("subscribed")) what = "pull";
    last_ = what + " by " + std::to_string(actor.index()) + " on " + topic;
    if (what == "subscribe") begin_reading(actor, topic);
    const bool looks = what == "borrow" || (what == "pull" && truth.at("borrowed").is_null());
    if (looks && truth.at("subscribed")) find_publishers(actor, topic);
    actor.act(topic, what, what == "advertise" ? ++publishers_ : random_() % 100);
  }

  /// Until there is no room, or readers have lost something.
  void fill(Actor& actor, const char* topic) {
    last_ = "push by " + std::to_string(actor.index()) + " on " + topic;
    for (unsigned n = 0; n < 2 * kDepth; ++n) {
      actor.act(topic, "loan");
      if (actor.act(topic, "push").at(topic).at("full")) return;
    }
  }

  void kill(std::size_t which) {
    ++kills_;
    const std::uint32_t index = actors_[which]->index();
    actors_[which]->kill9();
    // The others may have reaped it already, but soon nobody may call it alive: whoever reaps it
    // has its locks meanwhile, so that it looks as if it lived.
    for (bool looks_alive = true; looks_alive;) {
      const Ran ran = run_lot(on(options_, {"ls", "--json", "--interval", "1"}));
      const Json document = ran.json();
      looks_alive = false;
      for (const auto& p : segment_of(document).at("processes")) {
        if (p.at("index") != index) continue;
        looks_alive = p.at("alive");
        if (looks_alive) continue;
        CHECK(ran.exit == 1);
        ++deaths_seen_;
      }
    }
    remove(which);
  }

  void leave(std::size_t which) {
    REQUIRE(actors_[which]->leave() == 0);
    remove(which);
  }

  void remove(std::size_t which) {
    const std::uint32_t index = actors_[which]->index();
    actors_.erase(actors_.begin() + static_cast<std::ptrdiff_t>(which));
    std::erase_if(held_since_, [index](const auto& k) { return k.first.first == index; });
    std::erase_if(begun_, [index](const auto& b) { return b.first.first == index; });
    // Until it has been reaped it is still among the processes.
    REQUIRE(eventually([&] {
      const Json seen = run_lot(on(options_, {"ls", "--json", "--interval", "1"})).json();
      for (const auto& p : segment_of(seen).at("processes")) {
        if (p.at("index") == index) return false;
      }
      return true;
    }));
    enter();
  }

  /// A subscriber begins where each publisher stands.
  void begin_reading(const Actor& reader, const std::string& topic) {
    auto& begun = begun_[{reader.index(), topic}];
    begun.clear();
    for (const auto& a : actors_) {
      const Json& t = a->truth().at(topic);
      if (!t.at("publisher").is_null()) begun[t.at("publisher")] = t.at("pushed").size();
    }
  }

  /// A subscriber that looks finds the publishers that have come since: it begins with their first
  /// messages.
  void find_publishers(const Actor& reader, const std::string& topic) {
    auto& begun = begun_[{reader.index(), topic}];
    for (const auto& a : actors_) {
      const Json& t = a->truth().at(topic);
      if (!t.at("publisher").is_null()) begun.insert({t.at("publisher"), 0});
    }
  }

  static Blocks kept_by(const Actor& actor) {
    Blocks kept;
    for (const char* topic : kTopics) {
      for (const std::uint32_t b : actor.truth().at(topic).at("kept")) kept.insert(b);
    }
    return kept;
  }

  /// A borrow that becomes a pointer is one hold.
  void note_held(const Actor& actor, Clock::time_point before) {
    Blocks held = kept_by(actor);
    for (const char* topic : kTopics) {
      const Json& borrowed = actor.truth().at(topic).at("borrowed");
      if (!borrowed.is_null()) held.insert(borrowed.get<std::uint32_t>());
    }
    const std::uint32_t index = actor.index();
    std::erase_if(held_since_, [&](const auto& k) {
      return k.first.first == index && !held.contains(k.first.second);
    });
    for (const std::uint32_t b : held) held_since_.insert({{index, b}, before});
  }

  // ---- what is printed, and what is true
  // ----------------------------------------------------------

  void compare() {
    const Ran who_ran = run_lot(on(options_, {"who", "--all", "--json"}));
    const Ran ls_ran = run_lot(on(options_, {"ls", "--json", "--interval", "1"}));
    REQUIRE(who_ran.exit == 0);
    REQUIRE(ls_ran.exit == 0);
    const Json who_document = who_ran.json();
    const Json ls_document = ls_ran.json();
    const Json& who = segment_of(who_document);
    const Json& ls = segment_of(ls_document);
    CHECK(who.at("damage").empty());
    compare_processes(ls);
    compare_holders(who, ls);
    for (const auto& publisher : actors_) {
      for (const char* topic : kTopics) {
        if (!publisher->truth().at(topic).at("publisher").is_null()) {
          compare_queue(*publisher, topic, who, ls);
        }
      }
    }
  }

  void compare_processes(const Json& ls) const {
    std::map<std::uint32_t, pid_t> printed;
    std::map<std::uint32_t, pid_t> expected;
    for (const auto& p : ls.at("processes")) {
      CHECK(p.at("alive"));
      printed[p.at("index")] = p.at("pid");
    }
    for (const auto& a : actors_) expected[a->index()] = a->child().pid();
    CHECK(printed == expected);
  }

  void compare_holders(const Json& who, const Json& ls) {
    std::map<std::uint32_t, Blocks> keeps;
    std::map<std::uint32_t, Blocks> borrows;
    std::map<std::uint32_t, Blocks> spare;
    std::map<std::uint32_t, std::string> topic_of;
    for (const auto& m : who.at("messages")) {
      const std::uint32_t b = m.at("block");
      topic_of[b] = m.at("topic");
      for (const auto& h : m.at("holders")) {
        const std::uint32_t k = h.at("process");
        const auto how = h.at("how").get<std::string>();
        if (how == "keeps") {
          keeps[k].insert(b);
          check_age(h, k, b);
        } else if (how == "borrows") {
          borrows[k].insert(b);
        } else if (how == "spare") {
          CHECK(m.at("made_by") == k);
          CHECK(m.at("holders").size() == 1);
          spare[k].insert(b);
        }
      }
    }
    std::set<std::string> topics_in_use;
    for (const auto& t : ls.at("topics")) topics_in_use.insert(t.at("name"));
    for (const auto& a : actors_) {
      const std::uint32_t k = a->index();
      CAPTURE(k);
      CHECK(keeps[k] == kept_by(*a));
      keeps.erase(k);
      // A borrow from a queue that blocks is the reader's place in it: its lag says so.
      const Json& letter = a->truth().at(kLetters).at("borrowed");
      CHECK(borrows[k] == (letter.is_null() ? Blocks() : Blocks{letter.get<std::uint32_t>()}));
      borrows_seen_ += !letter.is_null();
      borrows.erase(k);
      for (const char* topic : kTopics) {
        const Json& truth = a->truth().at(topic);
        for (const std::uint32_t b : truth.at("loaned")) {
          CHECK(spare[k].contains(b));
          CHECK(topic_of.at(b) == topic);
        }
        for (const std::uint32_t b : truth.at("kept")) {
          if (topics_in_use.contains(topic)) CHECK(topic_of.at(b) == topic);
        }
      }
    }
    for (const auto& [k, blocks] : keeps) CHECK(blocks.empty());
    for (const auto& [k, blocks] : borrows) CHECK(blocks.empty());
  }

  /// It may be unknown, but it is never longer than the truth.
  void check_age(const Json& holder, std::uint32_t k, std::uint32_t b) {
    const auto since = held_since_.find({k, b});
    if (holder.at("seconds").is_null() || since == held_since_.end()) return;
    ++ages_;
    CHECK(holder.at("seconds").get<double>() <= seconds_since(since->second));
  }

  void compare_queue(const Actor& publisher, const std::string& topic, const Json& who,
                     const Json& ls) {
    const Json& truth = publisher.truth().at(topic);
    const std::uint32_t k = publisher.index();
    const std::uint64_t id = truth.at("publisher");
    const auto pushed = truth.at("pushed").get<std::vector<std::uint32_t>>();
    CAPTURE(k);
    CAPTURE(topic);

    std::map<std::uint64_t, std::uint32_t> queue;  // by number
    for (std::size_t n = pushed.size() - std::min<std::size_t>(pushed.size(), kDepth);
         n < pushed.size(); ++n) {
      queue[n] = pushed[n];
    }
    std::map<std::uint64_t, std::uint32_t> printed;
    for (const auto& m : who.at("messages")) {
      for (const auto& h : m.at("holders")) {
        if (h.at("how") == "queues" && h.at("process") == k && h.at("topic") == topic) {
          printed[h.at("sequence").get<std::uint64_t>() - kDepth] = m.at("block");
        }
      }
    }
    CHECK(printed == queue);

    const Json* entry = nullptr;
    const Json* subscribers = nullptr;
    for (const auto& t : ls.at("topics")) {
      if (t.at("name") != topic) continue;
      for (const auto& p : t.at("publishers")) {
        if (p.at("process") == k && !p.at("gone")) entry = &p;
      }
      subscribers = &t.at("subscribers");
    }
    REQUIRE(entry != nullptr);
    CHECK(entry->at("held") == queue.size());
    CHECK(entry->at("published") == pushed.size());
    CHECK(entry->at("depth") == kDepth);
    CHECK(entry->at("engine") == (engine_of(id) == lot::QueueEngine::Ring ? "ring" : "mutex"));
    CHECK(entry->at("policy") == (topic == kLetters ? "overwrite" : "block"));

    std::set<std::uint32_t> slow;
    std::set<std::uint32_t> readers;
    for (const auto& s : *subscribers) {
      if (s.at("channel") != entry->at("channel")) continue;
      const std::uint32_t r = s.at("process");
      CAPTURE(r);
      readers.insert(r);
      const Actor* reader = actor(r);
      REQUIRE(reader != nullptr);
      const std::uint64_t lag = pushed.size() - next_of(*reader, topic, id).value_or(0);
      CHECK(s.at("lag") == lag);
      losses_seen_ += topic == kLetters && lag > kDepth;
      CHECK(s.at("lost") == (topic == kLetters && lag > kDepth ? lag - kDepth : 0));
      if (lag >= kDepth && topic == kParcels) slow.insert(r);
    }
    for (const auto& a : actors_) {  // a subscriber has a cell, also before its first look
      CHECK((!a->truth().at(topic).at("subscribed") || readers.contains(a->index())));
    }
    compare_waiting(*entry, truth.at("full") && last_.starts_with("push by " + std::to_string(k)),
                    slow, who);
  }

  void compare_waiting(const Json& publisher, bool was_refused, const std::set<std::uint32_t>& slow,
                       const Json& who) {
    std::set<std::uint32_t> waits_for;
    for (const auto& w : who.at("waiting")) {
      if (w.at("channel") == publisher.at("channel")) {
        waits_for = w.at("waits_for").get<std::set<std::uint32_t>>();
      }
    }
    CHECK(publisher.at("waits_for_room") == !waits_for.empty());
    if (!waits_for.empty()) CHECK(waits_for == slow);
    if (was_refused && last_.ends_with(kParcels) && publisher.at("policy") == "block") {
      ++waits_seen_;
      CHECK(waits_for == slow);
      CHECK(!slow.empty());
    }
  }

  const Actor* actor(std::uint32_t index) const {
    for (const auto& a : actors_) {
      if (a->index() == index) return a.get();
    }
    return nullptr;
  }

  /// The number that the reader reads next; nothing when it need not have found the publisher yet.
  std::optional<std::uint64_t> next_of(const Actor& reader, const std::string& topic,
                                       std::uint64_t publisher) const {
    for (const auto& cursor : reader.truth().at(topic).at("cursors")) {
      if (cursor.at(0) == publisher) return cursor.at(1).get<std::uint64_t>();
    }
    const auto begun = begun_.find({reader.index(), topic});
    if (begun == begun_.end()) return {};
    const auto at = begun->second.find(publisher);
    if (at == begun->second.end()) return {};
    return at->second;
  }

  std::mt19937_64 random_;
  Room room_;
  lot::EngineOptions options_ = room_.options();
  std::vector<std::unique_ptr<Actor>> actors_;
  std::uint64_t publishers_ = 0;
  unsigned entered_ = 0;
  std::string last_;
  /// {reader, topic} -> publisher -> number
  std::map<std::pair<std::uint32_t, std::string>, std::map<std::uint64_t, std::uint64_t>> begun_;
  std::map<std::pair<std::uint32_t, std::uint32_t>, Clock::time_point> held_since_;
  unsigned kills_ = 0;
  unsigned ages_ = 0;
  unsigned deaths_seen_ = 0;
  unsigned waits_seen_ = 0;
  unsigned borrows_seen_ = 0;
  unsigned losses_seen_ = 0;
};

}  // namespace

TEST_SUITE_BEGIN("who");

TEST_CASE("lot who and lot ls say what four processes truly hold, after each of 250 random steps") {
  const Watchdog watchdog(300);
  Play play(seed());
  for (unsigned n = 0; n < 250; ++n) {
    CAPTURE(n);
    play.step(n);
  }
  play.last_act();
  std::printf("%u kills, %u deaths seen, %u ages, %u waits, %u borrows, %u losses\n", play.kills(),
              play.deaths_seen(), play.ages(), play.waits_seen(), play.borrows_seen(),
              play.losses_seen());
  CHECK(play.kills() != 0);
  CHECK(play.waits_seen() != 0);
  CHECK(play.borrows_seen() != 0);
  CHECK(play.losses_seen() != 0);
}

TEST_CASE("since when a message is kept is known after some seconds, and grows") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  Actor publisher(options, "publisher");
  Actor reader(options, "reader");
  publisher.act(kLetters, "advertise", 1);
  reader.act(kLetters, "subscribe");
  for (int n = 0; n < 2; ++n) {
    publisher.act(kLetters, "loan");
    publisher.act(kLetters, "push");
  }
  const auto before = Clock::now();
  reader.act(kLetters, "pull");
  reader.act(kLetters, "borrow");
  const auto ages = [&] {
    std::map<std::string, double> seconds;
    const Json document = run_lot(on(options, {"who", "--json"})).json();
    for (const auto& m : segment_of(document).at("messages")) {
      for (const auto& h : m.at("holders")) {
        CHECK(h.at("process") == reader.index());
        if (!h.at("seconds").is_null()) seconds[h.at("how")] = h.at("seconds");
      }
    }
    return seconds;
  };
  std::map<std::string, double> first;
  REQUIRE(eventually([&] { return (first = ages()).size() == 2; }, 40s));
  usleep(20000);
  const auto later = ages();
  for (const char* how : {"keeps", "borrows"}) {
    CHECK(later.at(how) >= first.at(how) + 0.02);
    CHECK(later.at(how) <= seconds_since(before));
  }
  // What is let go is forgotten; what comes after is young.
  reader.act(kLetters, "end");
  reader.act(kLetters, "release");
  CHECK(ages().empty());
  publisher.act(kLetters, "loan");
  publisher.act(kLetters, "push");
  reader.act(kLetters, "pull");
  const Json young = run_lot(on(options, {"who", "--json"})).json();
  REQUIRE(segment_of(young).at("messages").size() == 1);
  const Json& holder = segment_of(young).at("messages").at(0).at("holders").at(0);
  CHECK(holder.at("process") == reader.index());
  // It is not known yet, or no more than what has passed since the last look.
  CHECK(holder.at("seconds").is_null() != holder.at("at_most_seconds").is_null());
}

TEST_SUITE_END();
