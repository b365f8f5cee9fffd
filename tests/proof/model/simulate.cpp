// SPDX-License-Identifier: Apache-2.0
#include <cstdlib>
#include <new>

#include "scenario.hpp"

namespace lot::model {
namespace {

const Cast* playing = nullptr;
void* stage = nullptr;  // memory for its scene, the same in each execution

template <unsigned kThreads>
class Execution : public rl::test_suite<Execution<kThreads>, kThreads> {
 public:
  Execution() : play_(playing->make(stage)) {}
  ~Execution() { play_->~Play(); }

  void before() { play_->before(); }
  void thread(unsigned index) { play_->thread(index); }
  void after() { play_->after(); }

 private:
  Play* play_;
};

}  // namespace

bool simulate(const Scenario& scenario, rl::test_params& params) {
  const std::align_val_t alignment{scenario.cast.alignment};
  playing = &scenario.cast;
  stage = ::operator new(scenario.cast.bytes, alignment);
  bool holds = false;
  switch (scenario.cast.threads) {
    case 2:
      holds = rl::simulate<Execution<2>>(params);
      break;
    case 3:
      holds = rl::simulate<Execution<3>>(params);
      break;
    case 4:
      holds = rl::simulate<Execution<4>>(params);
      break;
    default:
      std::abort();
  }
  ::operator delete(stage, alignment);
  return holds;
}

}  // namespace lot::model
