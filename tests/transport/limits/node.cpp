// SPDX-License-Identifier: Apache-2.0

// One of very many processes of a segment.
//
//     limits_node join|read|publish DIRECTORY SEGMENT MESSAGES PARTNERS
//
// It says "." when it has joined and waits for a byte, twice: then it does its work; then it
// leaves.

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <unistd.h>

#include "lot/lot.hpp"

#include "message.hpp"

namespace {

using namespace std::chrono_literals;
using lot::testing::Numbered;

void require(bool condition, const char* what) {
  if (!condition) throw std::runtime_error(what);
}

void say_and_wait(int orders) {
  char order = 0;
  require(write(STDOUT_FILENO, ".", 1) == 1, "somebody listens");
  require(read(orders, &order, 1) == 1, "an order");
}

/// Each publisher's messages, in order, all of them.
void read_all(lot::ShmPuller<Numbered>& puller, std::uint64_t messages, std::uint64_t publishers) {
  std::map<std::uint64_t, std::uint64_t> next;
  for (std::uint64_t n = 0; n < messages * publishers; ++n) {
    const auto seen = puller.pull(100s);
    require(bool(seen), "a message");
    require(seen->number == next[seen->publisher]++, "the next of its publisher");
  }
  require(next.size() == publishers && puller.missed_total() == 0, "all of them");
}

void publish_all(lot::ShmPusher<Numbered>& pusher, std::uint64_t messages, std::size_t readers) {
  require(pusher.wait_for_readers(readers, 100s), "readers");
  for (std::uint64_t n = 0; n < messages; ++n) {
    auto message = pusher.loan();
    message->publisher = static_cast<std::uint64_t>(getpid());
    message->number = n;
    require(pusher.push(std::move(message)) == lot::Status::Ok, "pushed");
  }
}

}  // namespace

int main(int argc, char** argv) {
  alarm(200);
  try {
    require(argc == 6, "usage: limits_node join|read|publish DIRECTORY SEGMENT MESSAGES PARTNERS");
    const std::string role = argv[1];
    lot::EngineOptions options;
    options.directory = argv[2];
    options.segment = argv[3];
    const std::uint64_t messages = std::strtoull(argv[4], nullptr, 10);
    const std::uint64_t partners = std::strtoull(argv[5], nullptr, 10);
    const lot::PusherOptions lossless{lot::Policy::Block, 8, 100s};
    lot::ShmEngine engine(options);
    std::optional<lot::ShmPusher<Numbered>> pusher;
    std::optional<lot::ShmPuller<Numbered>> puller;
    if (role == "publish") pusher.emplace(engine.advertise<Numbered>("/t", lossless));
    if (role == "read") puller.emplace(engine.subscribe<Numbered>("/t"));
    say_and_wait(100);
    if (pusher) publish_all(*pusher, messages, partners);
    if (puller) read_all(*puller, messages, partners);
    say_and_wait(101);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "limits_node %s: %s\n", argc > 1 ? argv[1] : "", e.what());
    return 1;
  }
}
