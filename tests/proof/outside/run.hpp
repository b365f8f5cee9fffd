// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <initializer_list>
#include <optional>
#include <random>
#include <stdexcept>
#include <string>
#include <string_view>
#include <unistd.h>
#include <vector>

#include "proof/chaos/random.hpp"

/// What the three models have in common: a seed that decides all, a number of steps, a mistake to
/// plant, and the line by which a run is done again.
namespace lot::outside {

using chaos::Random;

/// The library does not do as the model does.
struct Differs : std::runtime_error {
  using std::runtime_error::runtime_error;
};

inline void require(bool same, const std::string& what) {
  if (!same) throw Differs(what);
}

/// A mistake that is made on purpose: a model that cannot fail proves nothing.
struct Mistake {
  const char* name;
  const char* says;
};

/// One run of a model.
class Run {
 public:
  Run(int argc, char** argv, unsigned steps, std::vector<Mistake> mistakes)
      : program_(argv[0]), steps_(steps), mistakes_(std::move(mistakes)) {
    for (int i = 1; i < argc; i += 2) read(argv[i], i + 1 < argc ? argv[i + 1] : nullptr);
    // A planted mistake may keep the program busy for ever. A limit from outside (can_fail.cmake)
    // would end the janitor as well, and leave the segment.
    if (!plant_.empty()) alarm(kMostSeconds);
    random_ = Random::of(seed_, 0);  // the numbers of seeds side by side have nothing in common
    std::printf("seed: %s\n", again().c_str());
    std::fflush(stdout);
  }

  Random& random() { return random_; }
  std::uint64_t seed() const { return seed_; }
  unsigned steps() const { return steps_; }
  bool planted(std::string_view mistake) const { return plant_ == mistake; }
  /// The command that does this run again.
  std::string again() const {
    return program_ + " --seed " + std::to_string(seed_) + " --steps " + std::to_string(steps_) +
           (plant_.empty() ? "" : " --plant " + plant_);
  }

  /// Does all steps, and returns 0. Ends the process with 1 where library and model differ.
  template <class Step>
  int all(Step&& step) {
    unsigned n = 0;
    try {
      for (; n < steps_; ++n) step(n);
    } catch (const std::exception& e) {
      std::printf("DIFFERS in step %u: %s\nagain: %s\n", n, e.what(), again().c_str());
      std::fflush(stdout);
      _exit(1);  // not by exit(): the janitor removes what this run leaves
    }
    return 0;
  }

 private:
  static constexpr unsigned kMostSeconds = 50;

  void read(const char* option, const char* value) {
    if (value == nullptr) usage();
    const std::string_view name(option);
    if (name == "--seed") {
      seed_ = std::strtoull(value, nullptr, 10);
    } else if (name == "--steps") {
      steps_ = static_cast<unsigned>(std::strtoul(value, nullptr, 10));
    } else if (name == "--plant" && is_mistake(value)) {
      plant_ = value;
    } else {
      usage();
    }
  }
  bool is_mistake(std::string_view name) const {
    return std::any_of(mistakes_.begin(), mistakes_.end(),
                       [name](const Mistake& m) { return name == m.name; });
  }
  [[noreturn]] void usage() const {
    std::fprintf(stderr, "usage: %s [--seed N] [--steps N] [--plant MISTAKE]\n", program_.c_str());
    for (const Mistake& m : mistakes_) std::fprintf(stderr, "  %-12s %s\n", m.name, m.says);
    std::exit(2);
  }
  /// LOT_TEST_SEED, or a new one.
  static std::uint64_t any_seed() {
    const char* given = std::getenv("LOT_TEST_SEED");
    return given != nullptr ? std::strtoull(given, nullptr, 10) : std::random_device{}();
  }

  std::string program_;
  unsigned steps_;
  std::vector<Mistake> mistakes_;
  std::uint64_t seed_ = any_seed();
  std::string plant_;
  Random random_{0};
};

/// Does all steps of a model, which the first one makes, and looks at the end.
template <class Model>
int run_model(Run& run) {
  std::optional<Model> model;
  return run.all([&](unsigned n) {
    if (!model) model.emplace(run);
    model->step(n);
    if (n + 1 == run.steps()) model->end();
  });
}

}  // namespace lot::outside
