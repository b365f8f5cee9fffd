// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <initializer_list>
#include <memory>
#include <vector>

#include "relacy.hpp"

namespace lot::model {

/// One execution of a scenario, as Relacy calls it. Relacy is a template on what it runs: so that
/// it is compiled once for each number of threads, and not for each scenario, it sees this.
class Play {
 public:
  virtual ~Play() = default;
  virtual void before() = 0;
  virtual void thread(unsigned index) = 0;
  virtual void after() = 0;
};

template <class Scene>
class PlayOf final : public Play {
 public:
  void before() override { scene_.before(); }
  void thread(unsigned index) override { scene_.thread(index); }
  void after() override { scene_.after(); }

 private:
  Scene scene_;
};

/// How a scene is made: each execution begins with a new one.
struct Cast {
  unsigned threads;
  std::size_t bytes;
  std::size_t alignment;
  Play* (*make)(void* memory);
};

template <class Scene>
constexpr Cast cast_of{
    Scene::params::thread_count, sizeof(PlayOf<Scene>), alignof(PlayOf<Scene>),
    [](void* memory) -> Play* { return std::construct_at(static_cast<PlayOf<Scene>*>(memory)); }};

struct Scenario {
  const char* name;
  const char* says;  ///< what must hold, as a sentence
  Cast cast;
  /// How many forced switches the bounded search affords in a minute; 0: it is not searched.
  unsigned bound = 0;
};

/// Runs it as `params` say; whether it holds.
bool simulate(const Scenario& scenario, rl::test_params& params);

/// All scenarios of the program: each file enters its own, so that a program may have few of them.
inline std::vector<Scenario>& scenarios() {
  static std::vector<Scenario> all;
  return all;
}

struct Entered {
  Entered(std::initializer_list<Scenario> more) {
    scenarios().insert(scenarios().end(), more.begin(), more.end());
  }
};

}  // namespace lot::model
