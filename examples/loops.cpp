// SPDX-License-Identifier: Apache-2.0
/// One puller in two event loops, epoll and Boost.Asio, by its descriptor. (glib.cpp: GLib.)
#include <array>
#include <functional>
#include <stdexcept>
#include <sys/epoll.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>

#include "numbers.hpp"

namespace {

using namespace std::chrono_literals;
using example::Count;

constexpr std::uint64_t kNumbers = 600;  // the first half for epoll, the second for Asio

void with_epoll(int fd, Count& count, std::uint64_t until) {
  const int epoll = epoll_create1(EPOLL_CLOEXEC);
  epoll_event event{};
  event.events = EPOLLIN;
  if (epoll_ctl(epoll, EPOLL_CTL_ADD, fd, &event) == -1) throw std::runtime_error("epoll");
  while (!count.reached(until)) {
    if (epoll_wait(epoll, &event, 1, 100) == 1) count.pull_all();
  }
  close(epoll);
}

void with_asio(int fd, Count& count, std::uint64_t until) {
  namespace asio = boost::asio;
  asio::io_context loop;
  asio::posix::stream_descriptor messages(loop, fd);
  const std::function<void()> wait = [&] {
    messages.async_wait(asio::posix::descriptor_base::wait_read, [&](auto error) {
      if (error) return;
      count.pull_all();
      wait();
    });
  };
  wait();
  while (!count.reached(until)) loop.run_one_for(100ms);
  messages.release();  // the descriptor is the puller's
}

}  // namespace

int main() {
  return example::run("loops", [] {
    const pid_t child =
        example::start("numbers", [] { return example::publish_numbers(kNumbers); });
    lot::ShmEngine engine;
    auto puller = engine.subscribe<example::Number>("/numbers");
    Count count(puller);
    with_epoll(puller.fd(), count, kNumbers / 2);
    std::printf("%ju numbers by epoll\n", static_cast<std::uintmax_t>(count.value()));
    const std::uint64_t before = count.value();
    with_asio(puller.fd(), count, kNumbers);
    std::printf("%ju numbers by Boost.Asio\n", static_cast<std::uintmax_t>(count.value() - before));
    return example::finish(child) && count.good() && count.value() == kNumbers;
  });
}
