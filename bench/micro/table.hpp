// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <utility>

#include "micro.hpp"

/// A game of ping-pong between two processes over two topics.
namespace bench {

enum class Use { Borrowed, Kept };

/// One process's half of the table: what it sends on and what it receives from.
template <class T>
struct End {
  lot::ShmPusher<T> out;
  lot::ShmPuller<T> in;

  static End make(lot::ShmEngine& engine, Companion& other, bool first, lot::Policy policy,
                  lot::Wait wait, bool fast_lane = false) {
    lot::PusherOptions pushing;
    pushing.policy = policy;
    pushing.fast_lane = fast_lane;
    lot::PullerOptions pulling;
    pulling.wait = wait;
    auto out = engine.advertise<T>(first ? "/ping" : "/pong", pushing);
    other.meet();  // both publish
    auto in = engine.subscribe<T>(first ? "/pong" : "/ping", pulling);
    other.meet();  // both listen
    return {std::move(out), std::move(in)};
  }
};

template <class T>
void send(End<T>& end, std::uint64_t n) {
  auto ball = end.out.loan();
  ball->fill(n);
  expect(end.out.push(std::move(ball)) == lot::Status::Ok, "push");
}

template <class T>
void receive(End<T>& end, std::uint64_t n, Use use) {
  if (use == Use::Borrowed) {
    const auto ball = end.in.borrow(10s);
    expect(ball && ball->is(n) && ball.missed() == 0, "a ball was lost");
  } else {
    const auto ball = end.in.pull(10s);
    expect(ball && ball->is(n) && end.in.missed() == 0, "a ball was lost");
  }
}

}  // namespace bench
