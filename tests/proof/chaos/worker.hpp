// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <utility>

#include "lot/lot.hpp"

#include "job.hpp"
#include "putter.hpp"
#include "taker.hpp"

namespace lot::chaos {

/// Takes items, changes them and puts them into the next queue: the same items, no copies.
class Worker final : public Job {
 public:
  Worker(Life& life, ShmEngine& engine, std::uint32_t from, std::uint32_t to)
      : life_(life), putter_(life, engine, to), taker_(life, engine, from) {}

  void turn() override {
    taker_.read([this](ShmUniquePtr<Plain> item) {
      if (life_.stage() > Stage::Awake) return;
      putter_.stamp(*item, item->stamp.serial, 0);
      fill(*item);
      putter_.put(item);  // refused: it is dropped, and its number goes to the next
    });
  }
  void quiet() override { taker_.quiet(); }
  bool settle() override { return taker_.settle(); }

 private:
  Life& life_;
  Putter<Plain> putter_;
  Taker<Plain> taker_;
};

}  // namespace lot::chaos
