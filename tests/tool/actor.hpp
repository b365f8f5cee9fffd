// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <unistd.h>
#include <vector>

#include <nlohmann/json.hpp>

#include "lot/lot.hpp"

#include "support/processes.hpp"
#include "transport/participant.hpp"

namespace lot::testing {

struct Letter {  // fits into a block's own payload
  std::uint64_t publisher;
  std::uint64_t number;
  std::uint32_t block;
};
struct Parcel {  // does not
  Letter letter;
  std::uint8_t bytes[6000];
};

inline const Letter& letter_of(const Letter& l) { return l; }
inline const Letter& letter_of(const Parcel& p) { return p.letter; }
inline Letter& letter_of(Letter& l) { return l; }
inline Letter& letter_of(Parcel& p) { return p.letter; }

constexpr const char* kLetters = "/letters";  ///< overwrites
constexpr const char* kParcels = "/parcels";  ///< blocks
constexpr std::uint32_t kDepth = 4;
/// Every second publisher has the other engine.
inline QueueEngine engine_of(std::uint64_t publisher) {
  return publisher % 2 == 0 ? QueueEngine::Mutex : QueueEngine::Ring;
}

/// What one process does on one topic, and what it then truly holds there.
template <class T>
class Desk {
 public:
  Desk(ShmEngine& engine, const char* topic, Policy policy)
      : engine_(engine), topic_(topic), policy_(policy) {}

  void act(const std::string& what, std::uint64_t number) {
    full_ = false;
    if (what == "advertise") {
      PusherOptions how;
      how.policy = policy_;
      how.depth = kDepth;
      how.engine = engine_of(number);
      how.fast_lane = false;  // truth() is of blocks
      pusher_.emplace(engine_.advertise<T>(topic_, how));
      id_ = number;
      pushed_.clear();
    } else if (what == "unadvertise") {
      loans_.clear();
      pusher_.reset();
    } else if (what == "subscribe") {
      puller_.emplace(engine_.subscribe<T>(topic_));
      cursors_.clear();
    } else if (what == "unsubscribe") {
      borrow_.end();
      puller_.reset();
    } else if (what == "loan" && pusher_) {
      auto message = pusher_->loan();
      letter_of(*message).block = detail::PointerAccess::control(message)->block;
      loans_.push_back(std::move(message));
    } else if (what == "drop" && !loans_.empty()) {
      loans_.erase(loans_.begin() + static_cast<std::ptrdiff_t>(number % loans_.size()));
    } else if (what == "push" && pusher_ && !loans_.empty()) {
      push(number % loans_.size());
    } else if (what == "pull" && puller_ && !borrow_) {
      auto message = puller_->try_pull();
      if (message) {
        saw(letter_of(*message), true);
        kept_.push_back(std::move(message));
      }
    } else if (what == "borrow" && puller_) {
      end_borrow();
      borrow_ = puller_->try_borrow();
      if (borrow_) saw(letter_of(*borrow_), false);
    } else if (what == "keep" && borrow_) {
      kept_.push_back(borrow_.keep());
    } else if (what == "end") {
      end_borrow();
    } else if (what == "release" && !kept_.empty()) {
      kept_.erase(kept_.begin() + static_cast<std::ptrdiff_t>(number % kept_.size()));
    }
  }

  nlohmann::json truth() const {
    nlohmann::json t = {{"loaned", nlohmann::json::array()},
                        {"kept", nlohmann::json::array()},
                        {"borrowed", nullptr},
                        {"publisher", nullptr},
                        {"pushed", pushed_},
                        {"full", full_},
                        {"subscribed", puller_.has_value()},
                        {"cursors", nlohmann::json::array()}};
    for (const auto& l : loans_) t["loaned"].push_back(letter_of(*l).block);
    std::set<std::uint32_t> kept;
    for (const auto& k : kept_) kept.insert(letter_of(*k).block);
    t["kept"] = kept;
    if (borrow_) t["borrowed"] = letter_of(*borrow_).block;
    if (pusher_) t["publisher"] = id_;
    for (const auto& [publisher, next] : cursors_) t["cursors"].push_back({publisher, next});
    return t;
  }

 private:
  void push(std::size_t which) {
    auto& message = loans_[which];
    Letter& letter = letter_of(*message);
    letter.publisher = id_;
    letter.number = pushed_.size();
    const std::uint32_t block = letter.block;
    full_ = pusher_->try_push(std::move(message)) == Status::Full;
    if (full_) return;  // still ours
    pushed_.push_back(block);
    loans_.erase(loans_.begin() + static_cast<std::ptrdiff_t>(which));
  }
  void saw(const Letter& letter, bool done) {
    cursors_[letter.publisher] = letter.number + (done ? 1 : 0);
    borrowed_from_ = letter.publisher;
  }
  void end_borrow() {
    if (!borrow_) return;
    borrow_.end();
    ++cursors_[borrowed_from_];
  }

  ShmEngine& engine_;
  const char* topic_;
  Policy policy_;
  std::optional<ShmPusher<T>> pusher_;
  std::optional<ShmPuller<T>> puller_;
  std::vector<ShmUniquePtr<T>> loans_;
  std::vector<ShmSharedPtr<const T>> kept_;
  ShmBorrow<T> borrow_;
  std::uint64_t id_ = 0;
  std::uint64_t borrowed_from_ = 0;
  bool full_ = false;                               ///< the last push found no room
  std::vector<std::uint32_t> pushed_;               ///< blocks, by number
  std::map<std::uint64_t, std::uint64_t> cursors_;  ///< by publisher: next number to read
};

/// A process that does what it is told, and says after each step what it truly holds.
class Actor {
 public:
  Actor(const EngineOptions& options, const std::string& name)
      : child_([&, this] { live(options, name); }) {
    truth_ = answer();
  }

  const nlohmann::json& act(const char* topic, const std::string& what, std::uint64_t number = 0) {
    const std::string order = nlohmann::json({topic, what, number}).dump() + "\n";
    for (const char c : order) orders_.tell(c);
    return truth_ = answer();
  }
  /// As it was after the last act.
  const nlohmann::json& truth() const { return truth_; }
  std::uint32_t index() const { return truth_.at("index").get<std::uint32_t>(); }
  const Child& child() const { return child_; }
  void kill9() { child_.kill9(); }
  int leave() {
    for (const char c : std::string("[]\n")) orders_.tell(c);
    return child_.wait();
  }

 private:
  static std::string line(const Steps& from) {
    std::string text;
    for (char c; (c = from.next(60s)) != '\n';) {
      must(c != 0, "the other process answers");
      text += c;
    }
    return text;
  }
  nlohmann::json answer() const { return nlohmann::json::parse(line(answers_)); }

  void live(const EngineOptions& options, const std::string& name) {
    EngineOptions mine = options;
    mine.name = name;
    ShmEngine engine(mine);
    const std::uint32_t index = detail::join(mine)->index();
    Desk<Letter> letters(engine, kLetters, Policy::Overwrite);
    Desk<Parcel> parcels(engine, kParcels, Policy::Block);
    for (;;) {
      const std::string text =
          nlohmann::json(
              {{"index", index}, {kLetters, letters.truth()}, {kParcels, parcels.truth()}})
              .dump() +
          "\n";
      for (const char c : text) answers_.tell(c);
      alarm(60);  // as Child, but from here on: a play may take longer
      const auto order = nlohmann::json::parse(line(orders_));
      if (order.empty()) return;
      const auto what = order.at(1).get<std::string>();
      const auto number = order.at(2).get<std::uint64_t>();
      if (order.at(0) == kLetters) {
        letters.act(what, number);
      } else {
        parcels.act(what, number);
      }
    }
  }

  Steps orders_, answers_;
  nlohmann::json truth_;
  Child child_;
};

}  // namespace lot::testing
