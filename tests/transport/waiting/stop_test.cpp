// SPDX-License-Identifier: Apache-2.0
// Every wait ends when it is told to stop: by a StopSource, a std::stop_source, a signal handler;
// and a wait for messages when the last publisher goes. The watchdog of the fixture ends a case in
// which one does not.
#include <atomic>
#include <csignal>
#include <functional>
#include <optional>
#include <poll.h>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "support/both_engines.hpp"
#include "support/in_a_moment.hpp"
#include "support/must_go.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::Status;
using lot::StopSource;
using lot::StopToken;
using lot::Wait;

struct Number {
  int value = 0;
};
struct Blob {
  lot::ShmVector<std::uint8_t> data;
};

constexpr Wait kWaits[] = {Wait::Spin, Wait::Adaptive, Wait::Park};

struct Fixture : BothEngines {
  static lot::PusherOptions with(QueueEngine engine) { return {Policy::Block, 2, 1h, engine}; }
  static lot::QueueOptions items(QueueEngine engine, Wait wait = Wait::Adaptive) {
    lot::QueueOptions options;
    options.depth = 2;
    options.engine = engine;
    options.wait = wait;
    return options;
  }
};

/// A wait that is told to stop; what it says must be true.
struct Form {
  std::string name;
  std::function<bool(const StopToken&)> waits;
};

/// Each form waits, and is stopped; then it waits no more. Waits with each form several times: a
/// habit of spinning gives up after some that were in vain.
void stop_each(const std::vector<Form>& forms) {
  for (const Form& form : forms) {
    CAPTURE(form.name);
    for (int times = 0; times < 6; ++times) {
      StopSource source;
      const StopToken token = source.get_token();
      const InAMoment stop([&] { source.request_stop(); });
      CHECK(form.waits(token));
      CHECK(token.stop_requested());
      CHECK(form.waits(token));  // at once
    }
  }
}

bool readable(int fd, int timeout_ms) {
  pollfd p{fd, POLLIN, 0};
  return poll(&p, 1, timeout_ms) == 1;
}

std::atomic<StopSource*> of_handler{nullptr};

}  // namespace

TEST_SUITE_BEGIN("stop");

TEST_CASE("a StopToken stops when its source is told to, for ever, and not before") {
  const StopToken never;
  CHECK_FALSE(never.stop_possible());
  CHECK_FALSE(never.stop_requested());

  StopToken token;
  {
    StopSource source;
    token = source.get_token();
    const StopSource copy = source;
    CHECK(token.stop_possible());
    CHECK_FALSE(token.stop_requested());
    CHECK(source.request_stop());
    CHECK_FALSE(source.request_stop());
    CHECK(copy.stop_requested());
    CHECK(copy.get_token() == token);
    CHECK(StopSource().get_token() != token);
    CHECK(never == StopToken());
  }
  CHECK(token.stop_requested());  // also when its source has gone
}

TEST_CASE("a std::stop_token becomes a token that stops when it does") {
  static_assert(std::is_convertible_v<std::stop_token, StopToken>);
  static_assert(!std::is_convertible_v<int, StopToken>);
  CHECK_FALSE(StopToken(std::stop_token()).stop_possible());
  std::stop_source source;
  const StopToken token = source.get_token();
  const StopToken copy = token;
  CHECK(token.stop_possible());
  CHECK_FALSE(copy.stop_requested());
  source.request_stop();
  CHECK(token.stop_requested());
  CHECK(copy.stop_requested());
  CHECK(StopToken(source.get_token()).stop_requested());  // it came before
}

TEST_CASE("request_stop() leaves errno alone") {
  StopSource source;
  errno = ENOENT;
  source.request_stop();
  CHECK(errno == ENOENT);
}

TEST_CASE_FIXTURE(Fixture, "each pull and borrow ends when it is told to stop") {
  with_each_engine([&](QueueEngine engine) {
    for (const Wait wait : kWaits) {
      CAPTURE(static_cast<int>(wait));
      lot::ShmEngine shm(options);
      auto pusher = shm.advertise<Number>("/t", with(engine));
      auto puller = shm.subscribe<Number>("/t", {wait, 0});
      const auto stopped = [&] { return puller.status() == Status::Stopped; };
      const auto in_an_hour = std::chrono::steady_clock::now() + 1h;
      const std::vector<Form> forms = {
          {"pull", [&](const auto& stop) { return !puller.pull(stop) && stopped(); }},
          {"pull 1h", [&](const auto& stop) { return !puller.pull(1h, stop) && stopped(); }},
          {"pull_until",
           [&](const auto& stop) { return !puller.pull_until(in_an_hour, stop) && stopped(); }},
          {"borrow", [&](const auto& stop) { return !puller.borrow(stop) && stopped(); }},
          {"borrow 1h", [&](const auto& stop) { return !puller.borrow(1h, stop) && stopped(); }},
          {"borrow_until",
           [&](const auto& stop) { return !puller.borrow_until(in_an_hour, stop) && stopped(); }},
      };
      stop_each(forms);

      // It takes nothing, also where there is something.
      must_go(pusher.push(pusher.loan(Number{7})));
      StopSource source;
      source.request_stop();
      for (const Form& form : forms) CHECK(form.waits(source.get_token()));
      CHECK(puller.size() == 1);
      const auto message = puller.pull(StopToken());
      REQUIRE(message);
      CHECK(message->value == 7);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a pull that may keep no more ends when it is told to stop") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Blob>("/t", {Policy::Block, 8, 1h, engine});
    lot::PullerOptions little;
    little.max_held_bytes = 1;
    auto puller = shm.subscribe<Blob>("/t", little);
    for (int n = 0; n < 2; ++n) {
      auto blob = pusher.loan();
      blob->data.resize(1 << 16);
      must_go(pusher.push(std::move(blob)));
    }
    const auto kept = puller.pull(1h);  // one is always allowed
    CHECK(puller.try_pull() == nullptr);
    REQUIRE(puller.status() == Status::HoldsTooMuch);
    stop_each({{"with a message", [&](const StopToken& stop) {
                  return !puller.pull(1h, stop) && puller.status() == Status::Stopped;
                }}});
    CHECK(puller.borrow(1h));  // borrowing is no keeping
    stop_each({{"without one", [&](const StopToken& stop) {
                  return !puller.pull(1h, stop) && puller.status() == Status::Stopped;
                }}});
  });
}

TEST_CASE_FIXTURE(Fixture, "each push that waits for room ends when it is told to stop") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", with(engine));
    auto puller = shm.subscribe<Number>("/t");
    lot::ShmUniquePtr<Number> unique = pusher.loan(Number{1});
    while (pusher.try_push(std::move(unique)) == Status::Ok) unique = pusher.loan(Number{1});
    const lot::ShmSharedPtr<Number> shared(pusher.loan(Number{2}));
    const lot::ShmSharedPtr<const Number> constant = shared;
    stop_each({
        {"unique",
         [&](const auto& stop) {
           return pusher.push(std::move(unique), stop) == Status::Stopped && unique;
         }},
        {"unique, 1h",
         [&](const auto& stop) {
           return pusher.push(std::move(unique), 1h, stop) == Status::Stopped && unique;
         }},
        {"shared", [&](const auto& s) { return pusher.push(shared, s) == Status::Stopped; }},
        {"shared, 1h",
         [&](const auto& s) { return pusher.push(shared, 1h, s) == Status::Stopped; }},
        {"const", [&](const auto& s) { return pusher.push(constant, s) == Status::Stopped; }},
        {"const, 1h",
         [&](const auto& s) { return pusher.push(constant, 1h, s) == Status::Stopped; }},
        {"readers", [&](const auto& stop) { return !pusher.wait_for_readers(2, stop); }},
        {"readers, 1h", [&](const auto& stop) { return !pusher.wait_for_readers(2, 1h, stop); }},
    });
    std::size_t n = 0;
    while (puller.try_pull()) ++n;
    CHECK(n < 4);  // none of these was published

    // Where there is room it publishes nothing either.
    StopSource source;
    source.request_stop();
    CHECK(pusher.push(std::move(unique), source.get_token()) == Status::Stopped);
    CHECK(pusher.push(constant, source.get_token()) == Status::Stopped);
    CHECK(puller.try_pull() == nullptr);
    CHECK(pusher.wait_for_readers(1, source.get_token()));  // no wait
  });
}

TEST_CASE_FIXTURE(Fixture, "each pop, take and put ends when it is told to stop") {
  with_each_engine([&](QueueEngine engine) {
    for (const Wait wait : kWaits) {
      lot::ShmEngine shm(options);
      auto queue = shm.queue<lot::ShmUniquePtr<Number>>("items", items(engine, wait));
      auto how = items(engine, wait);
      how.redeliver = true;
      auto tasks = shm.queue<lot::ShmUniquePtr<Number>>("tasks", how);
      const auto in_an_hour = std::chrono::steady_clock::now() + 1h;
      stop_each({
          {"pop", [&](const auto& stop) { return !queue.wait_and_pop(stop); }},
          {"pop_for", [&](const auto& stop) { return !queue.wait_and_pop_for(1h, stop); }},
          {"pop_until",
           [&](const auto& stop) { return !queue.wait_and_pop_until(in_an_hour, stop); }},
          {"take", [&](const auto& stop) { return !tasks.wait_and_take(stop); }},
          {"take_for", [&](const auto& stop) { return !tasks.wait_and_take_for(1h, stop); }},
          {"take_until",
           [&](const auto& stop) { return !tasks.wait_and_take_until(in_an_hour, stop); }},
      });

      auto item = queue.make(Number{1});
      while (queue.try_put(std::move(item)) == Status::Ok) item = queue.make(Number{1});
      stop_each({
          {"put",
           [&](const auto& stop) {
             return queue.put(std::move(item), stop) == Status::Stopped && item;
           }},
          {"put_for",
           [&](const auto& stop) {
             return queue.put_for(std::move(item), 1h, stop) == Status::Stopped && item;
           }},
          {"put_until",
           [&](const auto& stop) {
             return queue.put_until(std::move(item), in_an_hour, stop) == Status::Stopped && item;
           }},
      });
      StopSource source;
      source.request_stop();
      CHECK_FALSE(queue.wait_and_pop(source.get_token()));  // also where there are some
      CHECK(queue.size() == 2);

      auto values = shm.queue<Number>("values", items(engine, wait));
      const Number value{3};
      must_go(values.put(value, StopToken()));
      must_go(values.put_for(value, 1h, StopToken()));
      stop_each(
          {{"copy", [&](const auto& stop) { return values.put(value, stop) == Status::Stopped; }}});
      auto all = shm.queue<lot::ShmSharedPtr<const Number>>("all", items(engine, wait));
      all.listen();
      const lot::ShmSharedPtr<const Number> shared(all.make(Number{4}));
      while (all.try_put(shared) == Status::Ok) {
      }
      stop_each(
          {{"shared", [&](const auto& stop) { return all.put(shared, stop) == Status::Stopped; }}});
      // Items for one wait for the next handle.
      while (queue.try_pop() || values.try_pop()) {
      }
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a WaitSet runs until its token is told to stop") {
  with_each_engine([&](QueueEngine engine) {
    for (const Wait wait : kWaits) {
      lot::ShmEngine shm(options);
      auto pusher = shm.advertise<Number>("/t", with(engine));
      auto puller = shm.subscribe<Number>("/t");
      lot::WaitSet set(wait);
      int called = 0;
      set.add(puller, [&] {
        while (puller.try_pull()) ++called;
      });
      stop_each({{"run",
                  [&](const auto& stop) {
                    set.run(stop);
                    return true;
                  }},
                 {"run_once", [&](const auto& stop) { return set.run_once(1h, stop) == 0; }}});
      CHECK(called == 0);

      // A handler that leaves messages unread does not keep the set from stopping.
      must_go(pusher.push(pusher.loan(Number{1})));
      StopSource source;
      set.remove(puller);
      set.add(puller, [&] {
        if (++called == 3) source.request_stop();
      });
      set.run(source.get_token());
      CHECK(called == 3);
      set.stop();  // and stop() goes on to work beside a token
      set.run(StopToken());
      set.remove(puller);
      CHECK(puller.try_pull());
    }
  });
}

TEST_CASE("run_once() of a WaitSet says 0 where a handler has told its token to stop") {
  lot::WaitSet set;
  StopSource source;
  int called = 0;
  set.add_timer_once(0s, [&] {
    ++called;
    source.request_stop();
  });
  CHECK(set.run_once(1h, source.get_token()) == 0);
  CHECK(called == 1);
}

TEST_CASE_FIXTURE(Fixture, "a signal handler stops the thread that it interrupts, and others") {
  with_each_engine([&](QueueEngine engine) {
    StopSource source;
    of_handler = &source;
    struct sigaction handler {};
    struct sigaction before {};
    handler.sa_handler = [](int) { of_handler.load()->request_stop(); };
    sigaction(SIGUSR1, &handler, &before);
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", with(engine));
    auto puller = shm.subscribe<Number>("/t");
    auto other = shm.subscribe<Number>("/t");
    const StopToken token = source.get_token();
    std::thread second([&] { must(!other.pull(token), "it was stopped"); });
    {
      const pthread_t self = pthread_self();
      const InAMoment signal([&] { pthread_kill(self, SIGUSR1); });
      CHECK_FALSE(puller.pull(token));
    }
    second.join();
    CHECK(other.status() == Status::Stopped);
    sigaction(SIGUSR1, &before, nullptr);
  });
}

TEST_CASE_FIXTURE(Fixture, "a std::jthread is stopped by its own token") {
  with_each_engine([&](QueueEngine) {
    lot::ShmEngine shm(options);
    auto puller = shm.subscribe<Number>("/t");
    std::jthread thread([&](const std::stop_token& stop) { (void)puller.pull(stop); });
    thread.request_stop();
    thread.join();
    CHECK(puller.status() == Status::Stopped);
  });
}

TEST_CASE("stop_on_signals: the first signal stops, destructors run, and no file stays") {
  const Watchdog watchdog{100};
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) {
    for (const bool also_cleanly : {false, true}) {
      CAPTURE(number);
      const auto options = fresh();
      const Steps ready;
      Child child([&] {
        if (also_cleanly) lot::end_cleanly_on_signals();
        const StopToken stop = lot::stop_on_signals();
        must(stop == lot::stop_on_signals(), "one token");
        if (also_cleanly) lot::end_cleanly_on_signals();
        lot::ShmEngine shm(options);
        auto puller = shm.subscribe<Number>("/t");
        ready.tell();
        must(!puller.pull(stop), "no message");
        must(puller.status() == Status::Stopped, "stopped");
        raise(number);  // as a terminal and timeout(1) do: the same wish once more
      });
      REQUIRE(ready.next() == '.');
      child.send(number);
      CHECK(child.wait() == 0);
      CHECK(files_of(options) == 0);
    }
  }
}

TEST_CASE("stop_on_signals leaves a signal alone that is ignored, or has a handler") {
  const Watchdog watchdog{100};
  Child child([] {
    std::signal(SIGINT, SIG_IGN);
    std::signal(SIGTERM, [](int) {});
    const StopToken stop = lot::stop_on_signals();
    raise(SIGINT);
    raise(SIGTERM);
    must(!stop.stop_requested(), "no signal of ours stops it");
    Child grandchild([&] {
      raise(SIGHUP);
      must(stop.stop_requested(), "a child's own token");
    });
    must(grandchild.wait() == 0, "the child has ended by itself");
    must(!stop.stop_requested(), "the child's signal is not ours");
  });
  CHECK(child.wait() == 0);
}

TEST_CASE_FIXTURE(Fixture, "each wait for messages ends when the last publisher goes, once") {
  using Pull = std::function<bool(lot::ShmPuller<Number>&)>;
  const std::vector<std::pair<const char*, Pull>> forms = {
      {"pull", [](auto& puller) { return puller.pull() != nullptr; }},
      {"pull 1h", [](auto& puller) { return puller.pull(1h) != nullptr; }},
      {"borrow", [](auto& puller) { return bool(puller.borrow()); }},
      {"borrow 1h", [](auto& puller) { return bool(puller.borrow(1h)); }},
  };
  with_each_engine([&](QueueEngine engine) {
    for (const auto& form : forms) {
      const Pull& pull = form.second;
      for (const Wait wait : kWaits) {
        for (const bool is_killed : {false, true}) {
          // A process that lives so briefly may be seen to be dead a second later only.
          if (is_killed && (wait != Wait::Adaptive || &form != &forms.front())) continue;
          CAPTURE(form.first);
          lot::ShmEngine shm(options);
          auto puller = shm.subscribe<Number>("/t", {wait, 0});
          const Steps pushed, go;
          Child child([&] {
            lot::ShmEngine own(options);
            auto pusher = own.advertise<Number>("/t", with(engine));
            must_go(pusher.push(pusher.loan(Number{1})));
            must_go(pusher.push(pusher.loan(Number{2}), 20s));
            pushed.tell();
            go.next();
          });
          CHECK(pull(puller));  // it begins before there is a publisher, and waits for one
          CHECK(pushed.next() == '.');
          {
            const InAMoment end([&] {
              if (is_killed) child.kill9();
              go.tell();
            });
            CHECK(pull(puller));
            CHECK_FALSE(pull(puller));
            CHECK(puller.status() == Status::PublisherGone);
          }
          // It is told. The next one waits for another publisher, to its deadline.
          CHECK_FALSE(puller.pull(1ms));
          CHECK(puller.status() == Status::PublisherGone);
          CHECK_FALSE(puller.borrow(1ms));
          CHECK(puller.status() == Status::PublisherGone);
          std::optional<lot::ShmPusher<Number>> next;
          {
            const InAMoment come([&] {
              next = shm.advertise<Number>("/t", with(engine));
              must_go(next->push(next->loan(Number{3})));
            });
            CHECK(pull(puller));
          }
          CHECK_FALSE(puller.pull(1ms));
          CHECK(puller.status() == Status::Timeout);  // there is a publisher
          next.reset();
          CHECK_FALSE(pull(puller));
          CHECK(puller.status() == Status::PublisherGone);
          CHECK(puller.try_pull() == nullptr);
          CHECK(puller.status() == Status::PublisherGone);
        }
      }
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a publisher that goes while another one is there ends no wait") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto puller = shm.subscribe<Number>("/t");
    auto first = std::make_optional(shm.advertise<Number>("/t", with(engine)));
    auto second = shm.advertise<Number>("/t", with(engine));
    const InAMoment end([&] {
      first.reset();
      std::this_thread::sleep_for(2ms);
      must_go(second.push(second.loan(Number{1})));
    });
    CHECK(puller.pull() != nullptr);
  });
}

TEST_CASE_FIXTURE(Fixture, "a queue goes into a WaitSet, beside a puller") {
  with_each_engine([&](QueueEngine engine) {
    for (const Wait wait : kWaits) {
      lot::ShmEngine shm(options);
      auto pusher = shm.advertise<Number>("/t", with(engine));
      auto puller = shm.subscribe<Number>("/t");
      auto queue = shm.queue<lot::ShmUniquePtr<Number>>("items", items(engine));
      auto how = items(engine);
      how.redeliver = true;
      auto tasks = shm.queue<lot::ShmUniquePtr<Number>>("tasks", how);
      int popped = 0, taken = 0, pulled = 0;
      lot::WaitSet set(wait);
      set.add(puller, [&] {
        while (puller.try_pull()) ++pulled;
      });
      set.add(queue, [&] {
        while (queue.try_pop()) ++popped;
      });
      set.add(tasks, [&] {
        while (auto task = tasks.try_take()) {
          // given back at first: it comes again
          if (++taken > 1) task.finish();
        }
      });
      Child child([&] {
        lot::ShmEngine own(options);
        auto out = own.queue<lot::ShmUniquePtr<Number>>("items", items(engine));
        auto work = own.queue<lot::ShmUniquePtr<Number>>("tasks", how);
        for (int n = 0; n < 50; ++n) must_go(out.put(out.make(Number{n})));
        must_go(work.put(work.make(Number{1})));
      });
      must_go(pusher.push(pusher.loan(Number{1})));
      while (popped < 50 || taken < 2 || pulled < 1) set.run_once(10s);
      CHECK(popped == 50);
      CHECK(child.wait() == 0);
      while (set.run_once(1ms) != 0) {  // the ends of the child's rings are something to look at
      }
      set.remove(queue);
      must_go(queue.put(queue.make(Number{1})));
      CHECK(set.run_once(1ms) == 0);
      CHECK(queue.try_pop());
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a queue's descriptor is readable while there may be an item") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<lot::ShmUniquePtr<Number>>("items", items(engine));
    const int fd = queue.fd();
    CHECK(queue.fd() == fd);
    CHECK_FALSE(readable(fd, 0));
    Child child([&] {
      lot::ShmEngine own(options);
      auto out = own.queue<lot::ShmUniquePtr<Number>>("items", items(engine));
      for (int n = 0; n < 50; ++n) must_go(out.put(out.make(Number{n})));
    });
    int popped = 0;
    while (popped < 50) {
      REQUIRE(readable(fd, 20000));
      while (queue.try_pop()) ++popped;
    }
    CHECK(child.wait() == 0);
    must_go(queue.put(queue.make(Number{1})));
    CHECK(readable(fd, 20000));
    CHECK(readable(fd, 0));  // until it has looked
    CHECK(queue.wait_and_pop_for(1ms));
    CHECK_FALSE(queue.wait_and_pop_for(1ms));
    CHECK_FALSE(readable(fd, 0));
  });
}

TEST_SUITE_END();
