// SPDX-License-Identifier: Apache-2.0
/// What many_test.py meets: a program that has 200 types of many_types.py.
///
///     many types    prints each type: its name, size, alignment and hashes
///     many echo     sends a copy of one message of each type back, from /in/N to /out/N
#include <cstdio>
#include <exception>
#include <string>
#include <string_view>
#include <utility>

#include <lot/lot.hpp>

#include "many_types.hpp"

namespace {

struct Print {
  template <class T>
  void operator()() const {
    const lot::AnyType type = lot::AnyType::of<T>();
    std::printf("%s %zu %zu %llu %llu\n", type.name().c_str(), type.size(), type.alignment(),
                static_cast<unsigned long long>(type.description().layout_hash()),
                static_cast<unsigned long long>(type.description().names_hash()));
  }
};

/// Stops at the first one that fails.
struct Echo {
  lot::ShmEngine& engine;
  const lot::StopToken& stop;
  bool is_good = true;
  int number = 0;

  template <class T>
  void operator()() {
    if (!is_good) return;
    const std::string place = std::to_string(number++);
    auto in = engine.subscribe<T>("/in/" + place);
    auto out = engine.advertise<T>("/out/" + place);
    const auto seen = in.pull(stop);
    is_good = seen && out.push(out.loan(*seen)) == lot::Status::Ok;
  }
};

bool echo() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  Echo all{engine, stop};
  many::each(all);
  return all.is_good;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    if (argc == 2 && argv[1] == std::string_view("types")) {
      many::each(Print());
      return 0;
    }
    return echo() ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "many: %s\n", error.what());
    return 1;
  }
}
