// SPDX-License-Identifier: Apache-2.0
// Request and response: what a call says, also when servers and clients come, go, fail and die.
#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "segment/segment.hpp"
#include "support/both_engines.hpp"
#include "support/error_of.hpp"
#include "support/in_a_moment.hpp"
#include "support/must_go.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;
using lot::QueueEngine;
using lot::Status;
using lot::StopSource;

struct Sum {
  lot::ShmVector<std::uint32_t> numbers;
};
struct Total {
  std::uint64_t value;
  lot::ShmVector<std::uint32_t> numbers;  ///< again
};
using Client = lot::ShmClient<Sum, Total>;
using Server = lot::ShmServer<Sum, Total>;

void add_up(const Sum& sum, Total& total) {
  total.value = 0;
  for (const auto n : sum.numbers) total.value += n;
  total.numbers = sum.numbers;
}

/// A request: to add 1 to n up.
lot::ShmRequest<Sum> up_to(Client& client, std::uint32_t n) {
  auto request = client.loan();
  for (std::uint32_t i = 1; i <= n; ++i) request->numbers.push_back(i);
  return request;
}
constexpr std::uint64_t total_of(std::uint64_t n) { return n * (n + 1) / 2; }

/// A server process: `ready` when it serves, until it is killed or `go` is told.
template <class Handler>
Child serve(const lot::EngineOptions& options, const Steps& ready, const Steps& go,
            Handler handler) {
  return Child([&options, &ready, &go, handler] {
    lot::ShmEngine engine(options);
    const auto server = engine.serve<Sum, Total>("sum", handler);
    ready.tell();
    go.next(60s);
  });
}

using Call = lot::detail::Call<Sum>;

/// A server that is played by the test: it says what it likes to a request.
class PlayedServer {
 public:
  /// What it sends to a client.
  struct Answers {
    lot::ShmPusher<lot::detail::Answer<Total>> pusher;
    void push(std::uint64_t number, std::uint64_t value, bool gives_up, bool fails,
              const char* error) {
      auto answer = pusher.loan();
      answer->number = number;
      answer->has_given_up = gives_up;
      answer->has_failed = fails;
      answer->error = error;
      answer->response.value = value;
      must_go(pusher.push(std::move(answer)));
    }
  };

  PlayedServer(lot::ShmEngine& engine, const lot::EngineOptions& options)
      : engine_(engine),
        calls_(lot::detail::make_calls<Call>(lot::transport::Participant::join(options),
                                             "sum/calls", lot::Wait::Park)),
        presence_(engine.advertise<lot::detail::Serving<Sum, Total>>("sum/servers")) {
    calls_.listen();
  }
  ~PlayedServer() { join(); }
  PlayedServer(const PlayedServer&) = delete;
  PlayedServer& operator=(const PlayedServer&) = delete;

  /// Answers the next request, on another thread. A client stays in its topic while a call lasts.
  template <class How>
  void answers(How how) const {
    thread_ = std::thread([this, how] {
      auto task = calls_.wait_and_take_for(20s);
      if (!task) return;
      Answers to{engine_.advertise<lot::detail::Answer<Total>>("sum/answers/" +
                                                               std::to_string(task->client))};
      try {
        how(*task, to);
      } catch (const std::exception& e) {
        failure_ = e.what();
      }
      task.finish();
    });
  }
  /// Takes the next request, and leaves it to the caller.
  void takes(lot::ShmTask<Call>& task) const {
    thread_ = std::thread([this, &task] { task = calls_.wait_and_take_for(20s); });
  }
  void join() const {
    if (thread_.joinable()) thread_.join();
    CHECK(failure_ == "");
  }

 private:
  lot::ShmEngine& engine_;
  mutable lot::ShmQueue<lot::ShmUniquePtr<Call>> calls_;
  lot::ShmPusher<lot::detail::Serving<Sum, Total>> presence_;
  mutable std::thread thread_;
  mutable std::string failure_;
};

/// A fixture with both engines: the variable comes before the options of all queues.
struct Fixture : BothEngines {
  template <class Test>
  void each(Test&& test) {
    with_each_engine([&](QueueEngine engine) {
      setenv("LOT_QUEUE", engine == QueueEngine::Ring ? "ring" : "mutex", 1);
      test();
      unsetenv("LOT_QUEUE");
    });
  }
};

}  // namespace

TEST_SUITE_BEGIN("service");

TEST_CASE_FIXTURE(Fixture, "a call() gets the answer to its request, without a copy") {
  each([&] {
    const Steps ready, go;
    Child child = serve(options, ready, go, add_up);
    CHECK(ready.next() == '.');
    lot::ShmEngine engine(options);
    auto client = engine.client<Sum, Total>("sum");
    CHECK(client.servers() == 1);
    for (std::uint32_t n = 0; n < 300; ++n) {
      auto request = up_to(client, n);
      const auto answer = client.call(std::move(request), 20s);
      REQUIRE(answer);
      CHECK(client.status() == Status::Ok);
      CHECK(answer->value == total_of(n));
      CHECK(answer->numbers.size() == n);
      CHECK_FALSE(request);  // NOLINT: it was sent
    }
    // The answer lies where the server has built it: in the segment, not here.
    auto large = client.loan();
    large->numbers.resize(1 << 20, 3);
    const auto answer = client.call(std::move(large));
    REQUIRE(answer);
    CHECK(answer->value == std::uint64_t{3} << 20);
    const auto place = reinterpret_cast<std::uintptr_t>(answer->numbers.data());
    const auto message = reinterpret_cast<std::uintptr_t>(answer.get());
    CHECK(std::max(place, message) - std::min(place, message) < options.size_bytes);

    Sum copied;
    copied.numbers.assign(10, 1);
    CHECK(client.call(copied, 20s)->value == 10);
    CHECK(copied.numbers.size() == 10);
    go.tell();
    CHECK(child.wait() == 0);
  });
}

TEST_CASE_FIXTURE(Fixture, "an answer that is kept outlives its client, server and engine") {
  each([&] {
    lot::ShmSharedPtr<const Total> kept;
    {
      lot::ShmEngine engine(options);
      auto server = engine.serve<Sum, Total>("sum", add_up);
      auto client = engine.client<Sum, Total>("sum");
      kept = client.call(up_to(client, 4), 20s);
    }
    REQUIRE(kept);
    CHECK(kept->value == 10);
  });
}

TEST_CASE_FIXTURE(Fixture, "many clients and several servers: each request is done once") {
  constexpr std::uint32_t kServers = 3, kClients = 4, kCalls = 100;
  each([&] {
    lot::ShmEngine engine(options);
    std::atomic<std::uint32_t> done{0};
    std::vector<Server> servers;
    for (std::uint32_t s = 0; s < kServers; ++s) {
      servers.push_back(engine.serve<Sum, Total>("sum", [&done](const Sum& sum, Total& total) {
        add_up(sum, total);
        ++done;
      }));
    }
    std::vector<std::thread> threads;
    std::atomic<std::uint32_t> right{0};
    for (std::uint32_t c = 0; c < kClients; ++c) {
      threads.emplace_back([&, c] {
        auto client = engine.client<Sum, Total>("sum");
        for (std::uint32_t n = 0; n < kCalls; ++n) {
          const auto answer = client.call(up_to(client, n * kClients + c), 60s);
          right += answer && answer->value == total_of(n * kClients + c);
        }
      });
    }
    for (auto& thread : threads) thread.join();
    CHECK(right == kClients * kCalls);
    CHECK(done == kClients * kCalls);
    auto client = engine.client<Sum, Total>("sum");
    CHECK(client.servers() == kServers);
    servers.pop_back();
    CHECK(client.servers() == kServers - 1);
  });
}

TEST_CASE_FIXTURE(Fixture, "what a handler throws its client hears of, and the next call goes on") {
  each([&] {
    lot::ShmEngine engine(options);
    auto server = engine.serve<Sum, Total>("sum", [](const Sum& sum, Total& total) {
      total.numbers.resize(1000);
      if (sum.numbers.size() == 1) throw std::runtime_error("one is no sum");
      if (sum.numbers.size() == 2) throw 2;
      add_up(sum, total);
    });
    auto client = engine.client<Sum, Total>("sum");
    const auto [number, text] = error_of([&] { (void)client.call(up_to(client, 1), 20s); });
    CHECK(number == EREMOTEIO);
    CHECK(names(text, "one is no sum"));
    CHECK_FALSE(names(text, strerror(EREMOTEIO)));  // the system's words tell of other failures
    CHECK(names(text, "sum"));
    CHECK(error_of([&] { (void)client.call(up_to(client, 2), 20s); }).first == EREMOTEIO);
    CHECK(client.call(up_to(client, 3), 20s)->value == 6);
  });
}

TEST_CASE_FIXTURE(Fixture, "a service with other types, a bad name, a request that was sent") {
  each([&] {
    lot::ShmEngine engine(options);
    auto client = engine.client<Sum, Total>("sum");
    const auto [number, text] = error_of([&] { (void)engine.client<Total, Total>("sum"); });
    CHECK(number == EPROTOTYPE);
    CHECK_FALSE(names(text, strerror(EPROTOTYPE)));
    CHECK(error_of([&] { (void)engine.client<Sum, Sum>("sum"); }).first == EPROTOTYPE);
    const auto nothing = [](const Sum&, Sum&) {};
    CHECK(error_of([&] { (void)engine.serve<Sum, Sum>("sum", nothing); }).first == EPROTOTYPE);
    CHECK(error_of([&] { (void)engine.client<Sum, Total>(""); }).first == EINVAL);
    CHECK(error_of([&] { (void)engine.client<Sum, Total>(std::string(200, 'n')); }).first ==
          EINVAL);
    CHECK(error_of([&] { (void)client.call(lot::ShmRequest<Sum>(), 20s); }).first == EINVAL);
  });
}

TEST_CASE_FIXTURE(Fixture, "a call waits for a server, and keeps its request where none comes") {
  each([&] {
    lot::ShmEngine engine(options);
    auto client = engine.client<Sum, Total>("sum");
    auto request = up_to(client, 5);
    CHECK_FALSE(client.call(std::move(request), 1ms));
    CHECK(client.status() == Status::ServerGone);
    CHECK_FALSE(client.wait_for_server(1ms));
    CHECK(client.servers() == 0);
    REQUIRE(request);  // NOLINT: it was not sent
    std::optional<Server> server;
    const InAMoment come([&] { server = engine.serve<Sum, Total>("sum", add_up); });
    const auto answer = client.call(std::move(request));
    REQUIRE(answer);
    CHECK(answer->value == 15);
    CHECK(client.wait_for_server(0ms));
  });
}

TEST_CASE_FIXTURE(Fixture, "a late answer is dropped, and no server begins with a lapsed request") {
  each([&] {
    lot::ShmEngine engine(options);
    std::atomic<bool> held{true};
    std::atomic<int> begun{0};
    auto server = engine.serve<Sum, Total>("sum", [&](const Sum& sum, Total& total) {
      ++begun;
      while (held) std::this_thread::sleep_for(1ms);
      add_up(sum, total);
    });
    auto client = engine.client<Sum, Total>("sum");
    CHECK_FALSE(client.call(up_to(client, 2), 20ms));
    CHECK(client.status() == Status::Timeout);
    // The server is at work on the first. It never begins with the second.
    auto other = engine.client<Sum, Total>("sum");
    CHECK_FALSE(other.call(up_to(other, 3), 20ms));
    CHECK(other.status() == Status::Timeout);
    held = false;
    CHECK(client.call(up_to(client, 4), 20s)->value == 10);
    CHECK(other.call(up_to(other, 5), 20s)->value == 15);
    CHECK(begun == 3);
  });
}

TEST_CASE_FIXTURE(Fixture, "a call ends when it is told to stop") {
  each([&] {
    lot::ShmEngine engine(options);
    auto client = engine.client<Sum, Total>("sum");
    {
      StopSource source;
      const InAMoment stop([&] { source.request_stop(); });
      CHECK_FALSE(client.call(up_to(client, 1), source.get_token()));  // it waits for a server
      CHECK(client.status() == Status::Stopped);
      CHECK_FALSE(client.wait_for_server(source.get_token()));
    }
    std::atomic<bool> held{true}, begun{false};
    auto server = engine.serve<Sum, Total>("sum", [&](const Sum&, Total&) {
      begun = true;
      while (held) std::this_thread::sleep_for(1ms);
    });
    {
      StopSource source;
      const InAMoment stop([&] {
        must(eventually([&] { return begun.load(); }), "the server has taken the request");
        source.request_stop();
      });
      CHECK_FALSE(client.call(up_to(client, 1), 1h, source.get_token()));  // and for an answer
      CHECK(client.status() == Status::Stopped);
      CHECK_FALSE(client.call(up_to(client, 1), 1h, source.get_token()));  // at once
      CHECK(client.status() == Status::Stopped);
    }
    held = false;
  });
}

TEST_CASE_FIXTURE(Fixture, "a call hears at once of the death of its only server") {
  each([&] {
    lot::ShmEngine engine(options);
    auto client = engine.client<Sum, Total>("sum");
    const Steps ready, go, begun;
    const auto hang = [&begun](const Sum&, Total&) {
      begun.tell();
      pause();
    };
    Child child = serve(options, ready, go, hang);
    CHECK(ready.next() == '.');
    {
      std::thread kill([&] {
        must(begun.next() == '.', "it has begun");
        child.kill9();
      });
      CHECK_FALSE(client.call(up_to(client, 1)));  // without a limit
      kill.join();
    }
    CHECK(client.status() == Status::ServerGone);
    CHECK(client.servers() == 0);
    // The next server does not begin with that request.
    const Steps again;
    Child next = serve(options, again, go, add_up);
    CHECK(again.next() == '.');
    CHECK(client.call(up_to(client, 6), 20s)->value == 21);
    go.tell();
    CHECK(next.wait() == 0);
  });
}

TEST_CASE_FIXTURE(Fixture, "of several servers one dies at work: the call ends, or is done anew") {
  each([&] {
    for (const bool retry : {false, true}) {
      CAPTURE(retry);
      lot::ShmEngine engine(options);
      lot::ClientOptions how;
      how.retry = retry;
      auto client = engine.client<Sum, Total>("sum", how);
      const Steps ready, go, begun;
      Child child = serve(options, ready, go, [&begun](const Sum&, Total&) {
        begun.tell();
        pause();
      });
      CHECK(ready.next() == '.');
      std::optional<Server> other;
      std::thread kill([&] {
        must(begun.next() == '.', "it has begun");
        other = engine.serve<Sum, Total>("sum", add_up);
        child.kill9();
      });
      const auto answer = client.call(up_to(client, 7), 60s);
      kill.join();
      CHECK(client.status() == (retry ? Status::Ok : Status::ServerGone));
      CHECK(bool(answer) == retry);
      if (answer) CHECK(answer->value == 28);
      CHECK(client.call(up_to(client, 8), 20s)->value == 36);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a server that leaves finishes what it has begun, and no more") {
  each([&] {
    lot::ShmEngine engine(options);
    std::atomic<int> begun{0};
    std::atomic<bool> held{true};
    auto server =
        std::make_optional(engine.serve<Sum, Total>("sum", [&](const Sum& sum, Total& total) {
          ++begun;
          while (held) std::this_thread::sleep_for(1ms);
          add_up(sum, total);
        }));
    std::vector<std::thread> threads;
    std::atomic<int> answered{0}, gone{0}, late{0};
    for (int n = 0; n < 3; ++n) {
      threads.emplace_back([&] {
        auto client = engine.client<Sum, Total>("sum");
        const auto answer = client.call(up_to(client, 3), 5s);
        answered += answer && answer->value == 6;
        gone += client.status() == Status::ServerGone;
        late += client.status() == Status::Timeout;  // it came when the server had gone
      });
    }
    while (begun == 0) std::this_thread::sleep_for(1ms);
    std::this_thread::sleep_for(5ms);  // the others wait by then, most likely
    const InAMoment end([&] { held = false; });
    server.reset();
    for (auto& thread : threads) thread.join();
    CHECK(answered == begun);
    CHECK(answered + gone + late == 3);
    CHECK(answered >= 1);
    // A server drops what no server has taken.
    auto last = engine.serve<Sum, Total>("sum", add_up);
    auto after = engine.client<Sum, Total>("sum");
    CHECK(after.call(up_to(after, 4), 20s)->value == 10);
  });
}

TEST_CASE_FIXTURE(Fixture, "no server begins with a request whose client has died") {
  each([&] {
    lot::ShmEngine engine(options);
    std::atomic<int> begun{0};
    std::atomic<bool> held{true};
    const Steps at_work;
    auto server = engine.serve<Sum, Total>("sum", [&](const Sum& sum, Total& total) {
      if (++begun == 1) at_work.tell();
      while (held) std::this_thread::sleep_for(1ms);
      add_up(sum, total);
    });
    std::thread first([&] {
      auto client = engine.client<Sum, Total>("sum");
      must(client.call(up_to(client, 2), 60s) != nullptr, "answered");
    });
    CHECK(at_work.next() == '.');
    const Steps sent;
    Child child([&] {
      lot::ShmEngine own(options);
      auto client = own.client<Sum, Total>("sum");
      auto request = up_to(client, 3);
      sent.tell();
      (void)client.call(std::move(request));
    });
    CHECK(sent.next() == '.');
    std::this_thread::sleep_for(20ms);  // it waits by then, most likely
    child.kill9();
    {
      lot::segment::Segment segment(engine.path());
      const auto all = segment.participants();
      CHECK(eventually([&] {  // it is reaped: we are alone, beside the orphanage
        return std::count_if(all.begin() + 1, all.end(),
                             [](const auto& p) { return p.state.load() != 0; }) == 1;
      }));
    }
    held = false;
    first.join();
    auto client = engine.client<Sum, Total>("sum");
    CHECK(client.call(up_to(client, 4), 20s)->value == 10);
    CHECK(begun == 2);
  });
}

TEST_CASE_FIXTURE(Fixture, "an answer that may not be kept is told, and comes no more") {
  each([&] {
    lot::ShmEngine engine(options);
    auto server = engine.serve<Sum, Total>("sum", [](const Sum&, Total& total) {
      total.numbers.resize(1 << 20);  // 4 MiB: a quarter of the segment holds four
    });
    auto client = engine.client<Sum, Total>("sum");
    std::vector<lot::ShmSharedPtr<const Total>> kept;
    for (;;) {
      auto answer = client.call(up_to(client, 1), 20s);
      if (!answer) break;
      kept.push_back(std::move(answer));
      REQUIRE(kept.size() < 16);
    }
    CHECK(client.status() == Status::HoldsTooMuch);
    for (int n = 0; n < 6; ++n) {  // nor are requests sent
      CHECK_FALSE(client.call(up_to(client, 1), 20ms));
      CHECK(client.status() == Status::HoldsTooMuch);
    }
    kept.clear();
    CHECK(client.call(up_to(client, 1), 20s));
  });
}

TEST_CASE_FIXTURE(Fixture, "servers are killed at any time: each call ends, nothing is left") {
  each([&] {
    lot::ShmEngine engine(options);
    const auto start = [&] {
      return Child([&] {
        lot::ShmEngine own(options);
        const auto server = own.serve<Sum, Total>("sum", add_up);
        pause();
      });
    };
    std::vector<Child> servers;
    for (int n = 0; n < 2; ++n) servers.push_back(start());
    std::atomic<bool> ends{false};
    std::atomic<int> answered{0}, wrong{0};
    std::vector<std::thread> threads;
    for (int c = 0; c < 2; ++c) {
      threads.emplace_back([&, c] {
        lot::ClientOptions how;
        how.retry = c == 1;
        auto client = engine.client<Sum, Total>("sum", how);
        for (std::uint32_t n = 0; !ends; n = (n + 1) % 50) {
          const auto answer = client.call(up_to(client, n), 60s);
          const Status status = client.status();
          if (answer) {
            ++answered;
            wrong += answer->value != total_of(n);
          }
          wrong += status != Status::Ok && status != Status::ServerGone;
        }
      });
    }
    for (int kills = 0; kills < 20; ++kills) {
      std::this_thread::sleep_for(std::chrono::milliseconds(kills));
      servers[static_cast<std::size_t>(kills) % 2].kill9();
      servers[static_cast<std::size_t>(kills) % 2] = start();
    }
    CHECK(eventually([&] { return answered > 100; }, 60s));
    ends = true;
    for (auto& thread : threads) thread.join();
    servers.clear();
    CHECK(wrong == 0);
    // Requests that no server has taken wait for the next one, which drops them.
    auto server = engine.serve<Sum, Total>("sum", add_up);
    auto client = engine.client<Sum, Total>("sum");
    CHECK(client.call(up_to(client, 9), 60s)->value == 45);
  });
}

TEST_CASE_FIXTURE(Fixture, "a call that waits for a server drops the answer to the one before") {
  each([&] {
    lot::ShmEngine engine(options);
    auto client = engine.client<Sum, Total>("sum");
    std::atomic<bool> held{true};
    auto server =
        std::make_optional(engine.serve<Sum, Total>("sum", [&](const Sum& sum, Total& total) {
          while (held) std::this_thread::sleep_for(1ms);
          add_up(sum, total);
        }));
    CHECK_FALSE(client.call(up_to(client, 2), 5ms));
    held = false;
    server.reset();  // it has answered, and left
    std::optional<Server> next;
    const InAMoment come([&] { next = engine.serve<Sum, Total>("sum", add_up); });
    const auto answer = client.call(up_to(client, 5), 20s);
    REQUIRE(answer);
    CHECK(answer->value == 15);
  });
}

TEST_CASE_FIXTURE(Fixture, "a server is assigned to while its handler is at work") {
  each([&] {
    lot::ShmEngine engine(options);
    std::atomic<bool> begun{false};
    auto server = engine.serve<Sum, Total>("sum", [&](const Sum& sum, Total& total) {
      begun = true;
      std::this_thread::sleep_for(20ms);
      add_up(sum, total);
    });
    std::thread caller([&] {
      auto client = engine.client<Sum, Total>("sum");
      must(client.call(up_to(client, 3), 60s)->value == 6, "answered");
    });
    while (!begun) std::this_thread::sleep_for(1ms);
    server = engine.serve<Sum, Total>("sum", add_up);
    caller.join();
    auto client = engine.client<Sum, Total>("sum");
    CHECK(client.servers() == 1);
    CHECK(client.call(up_to(client, 4), 20s)->value == 10);
  });
}

TEST_CASE_FIXTURE(Fixture, "a request that cannot be answered holds up no other client") {
  each([&] {
    auto few = fresh();
    few.channels = 8;
    lot::ShmEngine engine(few);
    std::atomic<int> told{0};
    lot::ServerOptions how;
    how.thread.on_error = [&](const lot::Error& error) { told += error.error_number() == EIO; };
    auto server = engine.serve<Sum, Total>("sum", add_up, how);
    auto good = engine.client<Sum, Total>("sum");
    CHECK(good.call(up_to(good, 2), 20s)->value == 3);
    auto bad = engine.client<Sum, Total>("sum");
    auto request = up_to(bad, 3);
    // No channel is left for the answers to the other client.
    std::vector<lot::ShmPusher<Total>> others;
    const auto take_all = [&] {
      for (;;) others.push_back(engine.advertise<Total>("/" + std::to_string(others.size())));
    };
    CHECK(error_of(take_all).first == ENOSPC);
    CHECK_FALSE(bad.call(std::move(request), 200ms));
    CHECK(bad.status() == Status::Timeout);
    CHECK(told == 1);  // and not again and again
    CHECK(good.call(up_to(good, 4), 20s)->value == 10);
  });
}

TEST_CASE_FIXTURE(Fixture, "a call whose queue is full of lapsed ones ends with its server") {
  each([&] {
    lot::ShmEngine engine(options);
    auto client = engine.client<Sum, Total>("sum");
    const Steps ready, go, begun;
    Child child = serve(options, ready, go, [&begun](const Sum&, Total&) {
      begun.tell();
      pause();
    });
    CHECK(ready.next() == '.');
    CHECK_FALSE(client.call(up_to(client, 1), 20ms));
    CHECK(begun.next() == '.');
    for (int n = 0; n < 18; ++n) CHECK_FALSE(client.call(up_to(client, 1), 1ms));
    CHECK(client.status() == Status::Timeout);
    const InAMoment kill([&] { child.kill9(); });
    CHECK_FALSE(client.call(up_to(client, 1)));
    CHECK(client.status() == Status::ServerGone);
    // A server drops what no server has taken.
    auto last = engine.serve<Sum, Total>("sum", add_up);
    auto after = engine.client<Sum, Total>("sum");
    CHECK(after.call(up_to(after, 4), 20s)->value == 10);
  });
}

TEST_CASE_FIXTURE(Fixture, "a request that ends each server ends three of them at most") {
  each([&] {
    const Steps ready, go;
    std::vector<Child> servers;
    for (int n = 0; n < 4; ++n) {
      servers.push_back(serve(options, ready, go, [](const Sum& sum, Total& total) {
        if (sum.numbers.empty()) raise(SIGKILL);
        add_up(sum, total);
      }));
      CHECK(ready.next() == '.');
    }
    lot::ShmEngine engine(options);
    lot::ClientOptions how;
    how.retry = true;
    auto client = engine.client<Sum, Total>("sum", how);
    CHECK_FALSE(client.call(up_to(client, 0), 60s));
    CHECK(client.status() == Status::ServerGone);
    CHECK(client.call(up_to(client, 4), 60s)->value == 10);
    CHECK(client.servers() == 1);
    go.tell();
    int ended_well = 0;
    for (auto& server : servers) ended_well += server.wait() == 0;
    CHECK(ended_well == 1);
  });
}

TEST_CASE("by default a call is done once, and a server's thread has a name") {
  CHECK_FALSE(lot::ClientOptions().retry);
  CHECK(lot::ServerOptions().thread.name == "lot-serve");
  CHECK(static_cast<int>(lot::ClientOptions().wait) == static_cast<int>(lot::Wait::Adaptive));
  CHECK(static_cast<int>(lot::ServerOptions().wait) == static_cast<int>(lot::Wait::Adaptive));
}

TEST_CASE_FIXTURE(Fixture, "a request says who asks, which call it is, and if it may be retried") {
  each([&] {
    lot::ShmEngine engine(options);
    const PlayedServer server(engine, options);
    for (const bool retry : {false, true}) {
      CAPTURE(retry);
      lot::ClientOptions how;
      how.retry = retry;
      auto client = engine.client<Sum, Total>("sum", how);
      CHECK(client.status() == Status::Empty);
      CHECK(client.servers() == 1);
      std::uint64_t id = 0;
      for (std::uint64_t n = 1; n <= 3; ++n) {
        std::uint64_t waited_for = 0;
        server.answers([&](const Call& call, auto& answers) {
          id = id == 0 ? call.client : id;
          must(call.client == id, "the same client");
          must(call.number == n, "the number of the call");
          must(call.may_retry == retry, "whether it may be retried");
          waited_for = call.ticket->waits_for;
          must(call.request.numbers.size() == n, "the request");
          // What answers another call is dropped, and the first one that answers this counts.
          for (const std::uint64_t wrong : {n - 1, n + 1, std::uint64_t{0}}) {
            answers.push(wrong, 99, false, false, "");
          }
          answers.push(n, 10 + n, false, false, "");
          answers.push(n, 77, false, false, "");
        });
        const auto answer = client.call(up_to(client, static_cast<std::uint32_t>(n)), 20s);
        server.join();
        REQUIRE(answer);
        CHECK(answer->value == 10 + n);
        CHECK(client.status() == Status::Ok);
        CHECK(waited_for == n);
      }
      // The server at work has died, and no other one is to begin anew.
      server.answers([&](const Call& call, auto& answers) {
        answers.push(call.number, 0, true, false, "");
        answers.push(call.number, 5, false, false, "");
      });
      CHECK_FALSE(client.call(up_to(client, 1), 20s));
      server.join();
      CHECK(client.status() == Status::ServerGone);
      // Its handler has thrown.
      server.answers([&](const Call& call, auto& answers) {
        answers.push(call.number, 0, false, true, "too large");
      });
      const lot::Error expected(EREMOTEIO, "sum", "the server's handler has failed: too large",
                                "look at the server");
      CHECK(error_of([&] { (void)client.call(up_to(client, 1), 20s); }) ==
            std::pair{EREMOTEIO, std::string(expected.what())});
      server.join();
      CHECK(client.status() == Status::Ok);
      // The next call is another one.
      server.answers([&](const Call& call, auto& answers) {
        must(call.number == 6, "the sixth call");
        answers.push(6, 42, false, false, "");
      });
      CHECK(client.call(up_to(client, 1), 20s)->value == 42);
      server.join();
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a ticket names a call while it lasts, and none when it has ended") {
  each([&] {
    lot::ShmEngine engine(options);
    const PlayedServer server(engine, options);
    auto client = engine.client<Sum, Total>("sum");
    lot::ShmTask<Call> lapsed;
    server.takes(lapsed);
    CHECK_FALSE(client.call(up_to(client, 1), 30ms));
    CHECK(client.status() == Status::Timeout);
    server.join();
    REQUIRE(lapsed);
    CHECK(lapsed->number == 1);
    CHECK(lapsed->ticket->waits_for == 0);
    lapsed.finish();
  });
}

TEST_CASE_FIXTURE(Fixture, "a server's topics: who is there, and a queue for each client that is") {
  each([&] {
    lot::ShmEngine engine(options);
    auto server = engine.serve<Sum, Total>("sum", add_up);
    lot::PullerOptions latched;
    latched.history = 1;
    auto servers = engine.subscribe<lot::detail::Serving<Sum, Total>>("sum/servers", latched);
    const auto serving = servers.pull(20s);
    REQUIRE(serving);
    CHECK(serving->is_there == 1);
    lot::segment::Segment segment(engine.path());
    struct Answers {
      std::size_t refuse = 0;
      std::size_t live = 0;
    };
    const auto rings = [&] {
      Answers all;
      for (const auto& channel : segment.channels()) {
        if (lot::ring::writer_state(channel.writer.load()) != lot::ring::State::Live) continue;
        ++all.live;
        all.refuse +=
            channel.depth == 4 && channel.policy == static_cast<std::uint32_t>(lot::Policy::Refuse);
      }
      return all;
    };
    // The server leaves the queues of clients that have gone when it meets a new one.
    for (int n = 0; n < 5; ++n) {
      auto client = engine.client<Sum, Total>("sum");
      for (std::uint32_t i = 0; i < 3; ++i) CHECK(client.call(up_to(client, 4), 20s)->value == 10);
      CHECK(rings().refuse == 1);
      CHECK(rings().live == 3);  // and the requests, and who is there
    }
    auto one = engine.client<Sum, Total>("sum");
    auto two = engine.client<Sum, Total>("sum");
    for (auto* client : {&one, &two, &one}) CHECK(client->call(up_to(*client, 2), 20s)->value == 3);
    CHECK(rings().refuse == 2);
    CHECK(rings().live == 5);
  });
}

TEST_CASE_FIXTURE(Fixture, "a call that is told to stop copies no request, one too large says so") {
  each([&] {
    auto small = fresh(16 << 20);
    lot::ShmEngine engine(small);
    auto server = engine.serve<Sum, Total>("sum", add_up);
    auto client = engine.client<Sum, Total>("sum");
    Sum large;
    large.numbers.resize(16 << 20);  // 64 MiB
    StopSource source;
    source.request_stop();
    for (const auto timeout : {0ns, std::chrono::nanoseconds(1h)}) {
      CHECK_FALSE(client.call(large, timeout, source.get_token()));
      CHECK(client.status() == Status::Stopped);
    }
    CHECK_FALSE(client.call(large, source.get_token()));
    CHECK(client.status() == Status::Stopped);
    CHECK_THROWS_AS((void)client.call(large, 20s), lot::OutOfMemory);
    CHECK_THROWS_AS((void)client.call(large), lot::OutOfMemory);
    Sum right;
    right.numbers.assign(3, 2);
    CHECK(client.call(right)->value == 6);
    CHECK(client.call(right, 20s)->value == 6);
  });
}

TEST_CASE_FIXTURE(Fixture, "a client hears the text of a handler that has no memory") {
  each([&] {
    auto small = fresh(16 << 20);
    lot::ShmEngine engine(small);
    auto server = engine.serve<Sum, Total>("sum", [](const Sum& sum, Total& total) {
      add_up(sum, total);
      if (!sum.numbers.empty()) return;
      for (std::size_t n = 1 << 10;; n += 1 << 10) total.numbers.resize(n);
    });
    auto client = engine.client<Sum, Total>("sum");
    for (int n = 0; n < 3; ++n) {
      const auto [number, text] = error_of([&] { (void)client.call(up_to(client, 0), 20s); });
      CHECK(number == EREMOTEIO);
      CHECK(names(text, "the server's handler has failed: lot: "));
      CHECK(client.call(up_to(client, 4), 20s)->value == 10);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a client that may keep no more sends nothing, a full segment is told") {
  each([&] {
    lot::ShmEngine engine(options);
    std::atomic<int> begun{0};
    auto server = engine.serve<Sum, Total>("sum", [&](const Sum&, Total& total) {
      ++begun;
      total.numbers.resize(1 << 20);
    });
    auto client = engine.client<Sum, Total>("sum");
    std::vector<lot::ShmSharedPtr<const Total>> kept;
    while (auto answer = client.call(up_to(client, 1), 20s)) {
      kept.push_back(std::move(answer));
      REQUIRE(kept.size() < 16);
    }
    CHECK(client.status() == Status::HoldsTooMuch);
    const int before = begun;
    for (int n = 0; n < 3; ++n) {
      CHECK_FALSE(client.call(up_to(client, 1), 20ms));
      CHECK(client.status() == Status::HoldsTooMuch);
    }
    CHECK(begun == before);
    kept.clear();
    CHECK(client.call(up_to(client, 1), 20s));
    CHECK(begun == before + 1);
  });
  auto few = fresh();
  few.blocks = 16;
  lot::ShmEngine engine(few);
  auto other = engine.advertise<Total>("/t");
  std::vector<lot::ShmUniquePtr<Total>> loans;
  while (auto loan = other.try_loan()) loans.push_back(std::move(loan));
  const auto ask = [&] { auto client = engine.client<Sum, Total>("sum"); };
  CHECK_THROWS_AS(ask(), lot::OutOfMemory);
  loans.clear();
  CHECK_NOTHROW(ask());
}

TEST_SUITE_END();
