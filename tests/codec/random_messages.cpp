// SPDX-License-Identifier: Apache-2.0

// Writes types and values by chance, and what the codec makes of them, for independent.py:
//
//     random_messages SEED COUNT DIRECTORY
//
// N.msg and N.idl are the schema of type N, N.values its values, N.cdr its bytes. The names of the
// types go to stdout.

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <random>
#include <string>

#include "codec/encode.hpp"
#include "codec/random_types.hpp"
#include "codec/schema.hpp"

namespace {

void write(const std::string& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 4) throw std::runtime_error("usage: random_messages SEED COUNT DIRECTORY");
  std::mt19937_64 random(std::strtoull(argv[1], nullptr, 10));
  const unsigned long count = std::strtoul(argv[2], nullptr, 10);
  lot::testing::Heap heap(16 << 20);
  lot::codec::Encoded bytes;
  for (unsigned long i = 0; i < count; ++i) {
    const std::string number = std::to_string(i);
    const lot::Description type = lot::testing::RandomType(random, "t" + number).take();
    const lot::codec::Schema schema = lot::codec::schema_of(type);
    const lot::codec::Program program(type);
    heap.clear();
    const lot::MutableValue message = heap.make(type);
    lot::testing::RandomValues(random).fill(message);
    encode(program, message, bytes);
    const std::string path = std::string(argv[3]) + "/" + number;
    write(path + ".msg", schema.msg);
    write(path + ".idl", schema.idl);
    write(path + ".values", lot::testing::list_of_values(message));
    write(path + ".cdr", lot::testing::joined(bytes.pieces()));
    std::printf("%s\n", schema.name.c_str());
  }
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
