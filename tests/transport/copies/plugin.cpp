// SPDX-License-Identifier: Apache-2.0

#include "plugin.hpp"

#include <chrono>
#include <memory>
#include <optional>
#include <utility>

namespace lot::testing {
namespace {

using namespace std::chrono_literals;

class OwnCopy final : public Plugin {
 public:
  void join(const EngineOptions& options, const std::string& name) override {
    engine_ = std::make_unique<ShmEngine>(options);
    pusher_.emplace(engine_->advertise<Frame>("/" + name, {Policy::Overwrite, 4, 1s}));
    puller_.emplace(engine_->subscribe<Frame>("/" + name));
  }
  ShmSharedPtr<const Frame> make(std::uint64_t number) override { return loan(number); }
  ShmUniquePtr<Frame> loan(std::uint64_t number) override {
    auto frame = pusher_->loan();
    fill(*frame, number);
    return frame;
  }
  Status push(const ShmSharedPtr<const Frame>& frame) override { return pusher_->push(frame); }
  Status push(ShmUniquePtr<Frame>&& frame) override { return pusher_->push(std::move(frame)); }
  ShmSharedPtr<const Frame> pull() override { return puller_->pull(20s); }
  ShmSharedPtr<const Frame> keep(const ShmSharedPtr<const Frame>& frame) override {
    return std::exchange(kept_, frame);
  }
  ShmWeakPtr<const Frame> watch() const override { return kept_; }
  std::uint64_t refer() override {
    auto link = engine_->make<Link>();
    link->frame = kept_;
    return link->frame->number;
  }
  void leave() override {
    puller_.reset();
    pusher_.reset();
    engine_.reset();
  }

 private:
  std::unique_ptr<ShmEngine> engine_;
  std::optional<ShmPusher<Frame>> pusher_;
  std::optional<ShmPuller<Frame>> puller_;
  ShmSharedPtr<const Frame> kept_;
};

}  // namespace
}  // namespace lot::testing

extern "C" __attribute__((visibility("default"))) lot::testing::Plugin* make_plugin() {
  return new lot::testing::OwnCopy;
}
