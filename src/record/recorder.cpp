// SPDX-License-Identifier: Apache-2.0
#include "lot/recorder.hpp"

#include <cerrno>
#include <exception>
#include <mutex>
#include <pthread.h>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <utility>
#include <vector>

#include "lot/detail/no_signals.hpp"
#include "lot/error.hpp"
#include "lot/stop_token.hpp"

#include "record/observer.hpp"
#include "record/writing.hpp"

namespace lot {
namespace {

constexpr std::uint64_t kSmallestChunk = 1 << 10;

void check(const RecorderOptions& what) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw Error(EINVAL, "RecorderOptions", why, advice);
  };
  if (what.path.empty()) refuse("there is no path", "name a file: \"drive.mcap\"");
  if (what.topics.empty()) refuse("there are no topics", "name them, or \"*\" for all");
  if (what.chunk_bytes < kSmallestChunk) refuse("chunk_bytes is below 1024", "take 1 MiB");
  if (!(what.max_rate >= 0 && what.max_rate <= 1e9)) {
    refuse("max_rate is no number of messages a second", "0 means all");
  }
  const bool splits = what.split_bytes != 0 || what.split_time > Duration();
  if (splits && what.keep_last > Duration()) {
    refuse("keep_last and a split at once", "a file of the last seconds is not split");
  }
  if (what.keep_last > Duration()) return;
  if (!what.trigger.empty()) refuse("a trigger without keep_last", "say how long is kept");
  if (what.keep_after > Duration()) refuse("keep_after without keep_last", "say how long is kept");
}

std::thread begin_thread(const char* name, auto&& body) {
  const detail::NoSignals no_signals;
  try {
    std::thread thread(body);
    pthread_setname_np(thread.native_handle(), name);
    return thread;
  } catch (const std::system_error& e) {
    throw Error(e.code().value(), "Recorder", "the system starts no thread", "");
  }
}

}  // namespace

struct Recorder::Impl {
  Impl(RecorderOptions what, record::Join join)
      : options(std::move(what)),
        observer(options, std::move(join), ledger, clock, backlog),
        writing(options, ledger, clock, backlog) {}

  void begin() {
    std::vector<std::string> wanted = options.topics;
    wanted.insert(wanted.end(), options.except.begin(), options.except.end());
    if (!options.trigger.empty()) wanted.push_back(options.trigger);
    ledger.expects(std::move(wanted));
    observer.begin();
    writing.begin();
    writer = begin_thread("lot-record", [this] { writing.run(); });
    try {
      watcher = begin_thread("lot-observe", [this] { observer.run(stopping.get_token()); });
    } catch (...) {
      backlog.end();
      writer.join();
      throw;
    }
  }
  /// Ends both threads, once.
  void end() {
    stopping.request_stop();
    if (watcher.joinable()) watcher.join();
    backlog.end();
    if (writer.joinable()) writer.join();
  }

  const RecorderOptions options;
  record::Ledger ledger;
  record::Clock clock;
  record::Backlog backlog;
  record::Observer observer;
  record::Writing writing;
  StopSource stopping;
  std::once_flag ended;
  std::thread watcher;
  std::thread writer;
  const pid_t process = getpid();
};

Recorder::Recorder(RecorderOptions what, const EngineOptions& where)
    : Recorder(std::move(what), [where] { return detail::join(where); }) {}

Recorder::Recorder(RecorderOptions what,
                   std::function<std::shared_ptr<transport::Participant>()> join) {
  check(what);
  impl_ = std::make_unique<Impl>(std::move(what), std::move(join));
  impl_->begin();
}

Recorder::~Recorder() {
  if (impl_ == nullptr) return;
  if (getpid() != impl_->process) {
    (void)impl_.release();  // a forked child has none of its threads
    return;
  }
  try {
    std::call_once(impl_->ended, [this] { impl_->end(); });
  } catch (const std::exception&) {
    // A destructor has no way to say so; stop() has.
  }
}

void Recorder::trigger() noexcept {
  try {
    std::vector<record::Entry> trigger(1);
    impl_->backlog.put(trigger);
  } catch (const std::exception&) {
    // There is no memory for one entry: then there is none for a file either.
  }
}

void Recorder::stop() {
  bool is_first = false;
  std::call_once(impl_->ended, [&] {
    impl_->end();
    is_first = true;
  });
  if (is_first && impl_->writing.failure()) throw *impl_->writing.failure();
}

RecorderStatus Recorder::status() const {
  RecorderStatus told = impl_->ledger.told();
  told.held_bytes = impl_->backlog.held();
  return told;
}

}  // namespace lot
