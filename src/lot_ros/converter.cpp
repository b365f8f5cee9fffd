// SPDX-License-Identifier: Apache-2.0
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <tuple>
#include <typeindex>
#include <utility>
#include <vector>

#include <boost/weak_ptr.hpp>

#include "lot/detail/mutex.hpp"
#include "lot/ros/core.hpp"

namespace lot::ros {
namespace {

/// Names a message in shared memory, or a part of one (an aliasing pointer). The generation is in
/// it, since the next message of the block has the same control block and place.
struct Name {
  const lot::detail::ControlBlock* control = nullptr;
  std::uint64_t segment = 0;
  std::uint32_t generation = 0;  ///< which message of the block it is
  const void* place = nullptr;
  std::type_index standard = typeid(void);

  friend bool operator<(const Name& a, const Name& b) noexcept {
    return a.as_tuple() < b.as_tuple();
  }

 private:
  std::tuple<const void*, std::uint64_t, std::uint32_t, const void*, std::type_index> as_tuple()
      const noexcept {
    return {control, segment, generation, place, standard};
  }
};

/// The standard message that this process has made of one message. The thread that makes it holds
/// the mutex, so that other threads wait for it.
struct Made {
  lot::detail::Mutex mutex{lot::detail::Rank::Made};
  boost::weak_ptr<void const> standard;
};

/// The Made of each message whose shared standard message has a pointer left in this process.
class Known {
 public:
  static Known& the() {
    static auto* const known = new Known;  // messages may outlive main()
    return *known;
  }

  std::shared_ptr<Made> of(const Name& name) {
    const std::lock_guard guard(mutex_);
    auto& made = made_[name];
    auto found = made.lock();
    if (!found) made = found = std::make_shared<Made>();
    return found;
  }
  void forget(const Name& name) noexcept {
    const std::lock_guard guard(mutex_);
    const auto at = made_.find(name);
    if (at != made_.end() && at->second.expired()) made_.erase(at);
  }

 private:
  lot::detail::Mutex mutex_{lot::detail::Rank::Known};
  std::map<Name, std::weak_ptr<Made>> made_;
};

/// Released standard messages, whose memory is used again.
class Idle {
 public:
  explicit Idle(const detail::StandardKind& kind) : kind_(kind) {
    messages_.reserve(detail::Converter::kIdle);
  }
  ~Idle() {
    for (void* const message : messages_) kind_.destroy(message);
  }
  Idle(const Idle&) = delete;
  Idle& operator=(const Idle&) = delete;

  void* take() {
    {
      const std::lock_guard guard(mutex_);
      if (!messages_.empty()) {
        void* const last = messages_.back();  // most likely still in the caches
        messages_.pop_back();
        return last;
      }
    }
    return kind_.make();
  }
  void put(void* message) noexcept {
    {
      const std::lock_guard guard(mutex_);
      if (messages_.size() < detail::Converter::kIdle) return messages_.push_back(message);
    }
    kind_.destroy(message);
  }

 private:
  const detail::StandardKind& kind_;
  lot::detail::Mutex mutex_{lot::detail::Rank::Idle};
  std::vector<void*> messages_;
};

class IdleConverter final : public detail::Converter {
 public:
  explicit IdleConverter(const detail::Kind& kind)
      : kind_(kind), idle_(std::make_shared<Idle>(kind.standard)) {}

  Pointer make(const Pointer& message) override { return make(message, nullptr, Name()); }
  Pointer shared(const Pointer& message) override {
    const lot::detail::ControlBlock* const control = kind_.control_of(message);
    if (control == nullptr) return make(message);
    const Name name = name_of(control, message.get());
    const auto made = Known::the().of(name);
    const std::lock_guard guard(made->mutex);
    if (auto standard = made->standard.lock()) return standard;
    auto standard = make(message, made, name);
    made->standard = standard;
    return standard;
  }

 private:
  /// The deleter of a standard message: gives its memory to Idle. It keeps the Made alive for as
  /// long as the standard message has a pointer left.
  struct Return {
    std::shared_ptr<Idle> idle;
    std::shared_ptr<Made> made;
    Name name;
    void operator()(void* standard) noexcept {
      idle->put(standard);
      if (made == nullptr) return;
      made.reset();
      Known::the().forget(name);
    }
  };

  Name name_of(const lot::detail::ControlBlock* control, const void* place) const {
    Name name;
    name.control = control;
    name.segment = control->hub->instance(control);
    name.generation = control->hub->generation(control);
    name.place = place;
    name.standard = *kind_.standard.type;
    return name;
  }
  Pointer make(const Pointer& message, std::shared_ptr<Made> made, const Name& name) {
    boost::shared_ptr<void> standard(idle_->take(), Return{idle_, std::move(made), name});
    kind_.standard.assign(standard.get(), message.get());
    return standard;
  }

  const detail::Kind& kind_;
  const std::shared_ptr<Idle> idle_;
};

}  // namespace

std::shared_ptr<detail::Converter> detail::make_converter(const Kind& kind) {
  return std::make_shared<IdleConverter>(kind);
}

}  // namespace lot::ros
