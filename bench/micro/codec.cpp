// SPDX-License-Identifier: Apache-2.0
#include <cstring>

#include "codec/decode.hpp"
#include "codec/encode.hpp"
#include "micro.hpp"

/// What an image of 16 MiB costs as CDR, and back, beside a plain copy of its pixels between the
/// same places: memory of a message, and a buffer on the heap. All memory is warm.
namespace bench {
namespace {

constexpr std::size_t kBytes = 16 << 20;

struct Image {
  std::uint64_t stamp = 0;
  lot::ShmString frame;
  std::uint32_t height = 0;
  std::uint32_t width = 0;
  lot::ShmString encoding;
  std::uint32_t step = 0;
  lot::ShmVector<std::uint8_t> data;
};

lot::EngineOptions roomy() {
  lot::EngineOptions options = segment();
  options.size_bytes = 256 << 20;
  return options;
}

lot::Bytes bytes_of(const std::vector<std::byte>& bytes) { return {bytes.data(), bytes.size()}; }

/// An image, its bytes by the codec, and what a plain copy has of both.
class Desk {
 public:
  Desk() {
    const lot::MutableValue image = image_.root();
    image["stamp"].set(1);
    image["frame"].set("camera");
    image["height"].set(2048);
    image["width"].set(2731);
    image["encoding"].set("rgb8");
    image["step"].set(3 * 2731);
    image["data"].resize(kBytes);
    copied_.root()["data"].resize(kBytes);
    renew();
    encode(program_, image, encoded_);
  }

  double encode_all() {
    renew();
    const double ns = time_ns(1, [&] { encode(program_, image_.root(), encoded_); });
    expect(ends_with_pixels(encoded_.pieces().back()), "the bytes of an image");
    return ns;
  }
  /// The pixels stay where they are.
  double encode_pieces() {
    renew();
    std::vector<lot::Bytes> pieces;
    const double ns = time_ns(1, [&] {
      encode(program_, image_.root(), in_pieces_);
      pieces = in_pieces_.pieces();
    });
    expect(ends_with_pixels(pieces.back()), "the pieces of an image");
    return ns;
  }
  /// The pixels into a buffer.
  double copy_out() {
    renew();
    const double ns = time_ns(1, [&] { std::memcpy(buffer_.data(), pixels(image_), kBytes); });
    expect(ends_with_pixels(bytes_of(buffer_)), "a copy of pixels");
    return ns;
  }

  double decode_all() {
    return time_ns(1, [&] {
      const lot::AnyLoan loan = out_.loan();
      decode(program_, encoded_.pieces().front(), loan.root());
      expect(pixels(loan)[kBytes - 1] == pixels(image_)[kBytes - 1], "the pixels that come back");
    });
  }
  /// The pixels into a message.
  double copy_in() {
    return time_ns(1, [&] {
      std::memcpy(pixels(copied_), buffer_.data(), kBytes);
      benchmark::ClobberMemory();
    });
  }

 private:
  static unsigned char* pixels(const lot::AnyLoan& message) {
    const lot::Value data = message.root().value()["data"];
    return static_cast<unsigned char*>(const_cast<void*>(data[0].address()));
  }
  /// Other pixels than before, so that no block finds what an earlier one has left.
  void renew() { std::memset(pixels(image_), static_cast<int>(++round_ % 251), kBytes); }
  bool ends_with_pixels(lot::Bytes bytes) const {
    return bytes.size() >= kBytes &&
           std::memcmp(bytes.data() + (bytes.size() - kBytes), pixels(image_), kBytes) == 0;
  }

  lot::ShmEngine engine_{roomy()};
  lot::AnyPusher out_ = engine_.advertise_any("/codec", lot::AnyType::of<Image>());
  lot::codec::Program program_{out_.type().description()};
  lot::AnyLoan image_ = out_.loan();
  lot::AnyLoan copied_ = out_.loan();
  lot::codec::Encoded encoded_;
  lot::codec::Encoded in_pieces_{64 << 10};
  std::vector<std::byte> buffer_ = std::vector<std::byte>(kBytes);
  std::uint64_t round_ = 0;
};

template <class Arm, class Floor>
void compare(benchmark::State& state, Arm&& arm, Floor&& floor) {
  pin(0);
  {
    Desk desk;
    arm(desk);
    floor(desk);
    Rounds rounds;
    for ([[maybe_unused]] auto _ : state) {
      rounds.run([&] { return arm(desk); }, [&] { return floor(desk); });
    }
    rounds.report(state);
  }
  unpin();
}

void out(benchmark::State& state) {
  compare(
      state, [](Desk& desk) { return desk.encode_all(); },
      [](Desk& desk) { return desk.copy_out(); });
}
void in_pieces(benchmark::State& state) {
  compare(
      state, [](Desk& desk) { return desk.encode_pieces(); },
      [](Desk& desk) { return desk.copy_out(); });
}
void back(benchmark::State& state) {
  compare(
      state, [](Desk& desk) { return desk.decode_all(); },
      [](Desk& desk) { return desk.copy_in(); });
}
void out_and_back(benchmark::State& state) {
  compare(
      state, [](Desk& desk) { return desk.encode_all() + desk.decode_all(); },
      [](Desk& desk) { return desk.copy_out() + desk.copy_in(); });
}

}  // namespace

BENCHMARK(out)->Name("codec/16MiB/encode")->UseRealTime();
BENCHMARK(in_pieces)->Name("codec/16MiB/encode_in_pieces")->UseRealTime();
BENCHMARK(back)->Name("codec/16MiB/decode")->UseRealTime();
BENCHMARK(out_and_back)->Name("codec/16MiB/both")->UseRealTime();

}  // namespace bench
