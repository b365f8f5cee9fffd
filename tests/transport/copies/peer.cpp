// SPDX-License-Identifier: Apache-2.0

// A publisher or a reader: compilers_test starts them, built by one compiler and by another.
//
//     peer publish|read DIRECTORY SEGMENT COUNT READERS

#include <array>
#include <chrono>
#include <complex>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <string>
#include <tuple>
#include <unistd.h>
#include <utility>

#include "lot/boost_containers.hpp"
#include "lot/lot.hpp"

namespace peer {

using namespace std::chrono_literals;

enum class Kind : std::uint8_t { None, Car, Person };
struct alignas(32) Corner {
  double x, y, z;
};
struct Object {
  Kind kind;
  bool moving;
  std::uint32_t id : 20;
  std::uint32_t age : 12;
  lot::ShmString name;
  lot::ShmVector<Corner> corners;
};
/// A little of everything that a message may have.
struct Scene {
  std::uint64_t number;
  std::chrono::nanoseconds stamp;
  std::array<lot::ShmString, 2> notes;
  std::pair<char, long double> scale;
  std::tuple<std::int16_t, float, std::int64_t> mixed;
  std::complex<double> phase;
  lot::ShmVector<Object> objects;
  lot::ShmVector<std::uint8_t> pixels;
  lot::ShmMap<std::uint32_t, lot::ShmString> names;
  lot::ShmFlatSet<std::int32_t> ids;
  lot::ShmDeque<std::uint16_t> track;
  lot::ShmRef<const Object> chosen;
};

const char* const kText = "a text that is much too long for the small string in place";

void fill(Scene& scene, lot::ShmEngine& engine, std::uint64_t n) {
  scene.number = n;
  scene.stamp = std::chrono::nanoseconds(n);
  scene.notes[0] = "short";
  scene.notes[1] = kText;
  scene.scale = {'s', static_cast<long double>(n) / 3};
  scene.mixed = {static_cast<std::int16_t>(n), 0.5F, -static_cast<std::int64_t>(n)};
  scene.phase = {1.0, static_cast<double>(n)};
  scene.objects.resize(5);
  for (std::uint32_t i = 0; i < 5; ++i) {
    Object& object = scene.objects[i];
    object.kind = Kind::Person;
    object.moving = i % 2 == 1;
    object.id = i & 0xfffffU;
    object.age = static_cast<std::uint32_t>(n) & 0xfffU;
    object.name = kText;
    object.corners.assign(4, Corner{1.0, static_cast<double>(n), static_cast<double>(i)});
  }
  scene.pixels.assign(200000, static_cast<std::uint8_t>(n));
  for (std::uint32_t i = 0; i < 50; ++i) {
    scene.names[i] = kText;
    scene.ids.insert(static_cast<std::int32_t>(50 - i));
    scene.track.push_front(static_cast<std::uint16_t>(i));
  }
  auto chosen = engine.make<Object>();
  chosen->kind = Kind::Car;
  chosen->name = kText;
  scene.chosen = lot::ShmSharedPtr<const Object>(std::move(chosen));
}

bool good(const Scene& scene, std::uint64_t n) {
  bool ok = scene.number == n && scene.stamp == std::chrono::nanoseconds(n) &&
            scene.notes[0] == "short" && scene.notes[1] == kText && scene.scale.first == 's' &&
            scene.scale.second == static_cast<long double>(n) / 3 &&
            scene.mixed ==
                std::tuple(static_cast<std::int16_t>(n), 0.5F, -static_cast<std::int64_t>(n)) &&
            scene.phase.imag() == static_cast<double>(n) && scene.objects.size() == 5 &&
            scene.pixels.size() == 200000 && scene.pixels.back() == static_cast<std::uint8_t>(n) &&
            scene.names.size() == 50 && scene.ids.size() == 50 && scene.track.size() == 50;
  for (std::uint32_t i = 0; ok && i < 5; ++i) {
    const Object& object = scene.objects[i];
    ok = object.kind == Kind::Person && object.moving == (i % 2 == 1) && object.id == i &&
         object.age == (n & 0xfff) && object.name == kText && object.corners.size() == 4 &&
         object.corners[3].y == static_cast<double>(n) && object.corners[3].z == i;
  }
  for (std::uint32_t i = 0; ok && i < 50; ++i) {
    ok = scene.names.at(i) == kText && scene.ids.count(static_cast<std::int32_t>(i) + 1) == 1 &&
         scene.track[i] == 49 - i;
  }
  const auto chosen = scene.chosen.lock();
  return ok && chosen && chosen->kind == Kind::Car && chosen->name == kText;
}

void require(bool condition, const char* what) {
  if (!condition) throw std::runtime_error(what);
}

void publish(lot::ShmEngine& engine, std::uint64_t count, std::size_t readers) {
  auto pusher = engine.advertise<Scene>("/scene", {lot::Policy::Block, 4, 50s});
  require(pusher.wait_for_readers(readers, 50s), "readers");
  for (std::uint64_t n = 0; n < count; ++n) {
    auto scene = pusher.loan();
    fill(*scene, engine, n);
    require(pusher.push(std::move(scene)) == lot::Status::Ok, "pushed");
  }
}

void read(lot::ShmEngine& engine, std::uint64_t count) {
  auto puller = engine.subscribe<Scene>("/scene");
  lot::ShmSharedPtr<const Scene> kept;
  for (std::uint64_t n = 0; n < count; ++n) {
    const auto seen = puller.pull(50s);
    require(bool(seen), "a scene");
    require(good(*seen, n), "as it was made");
    if (n % 10 == 0) kept = seen;
    require(good(*kept, n - n % 10), "what is kept");
  }
}

}  // namespace peer

int main(int argc, char** argv) {
  alarm(100);
  try {
    peer::require(argc == 6, "usage: peer publish|read DIRECTORY SEGMENT COUNT READERS");
    lot::EngineOptions options;
    options.directory = argv[2];
    options.segment = argv[3];
    options.size_bytes = 64 << 20;
    lot::ShmEngine engine(options);
    const std::uint64_t count = std::strtoull(argv[4], nullptr, 10);
    if (std::strcmp(argv[1], "publish") == 0) {
      peer::publish(engine, count, std::strtoull(argv[5], nullptr, 10));
    } else {
      peer::read(engine, count);
    }
  } catch (const std::exception& e) {
    std::fprintf(stderr, "peer %s: %s\n", argc > 1 ? argv[1] : "", e.what());
    return 1;
  }
}
