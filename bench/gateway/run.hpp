// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <linux/futex.h>
#include <new>
#include <stdexcept>
#include <string>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

/// What both arms of hop.py do alike: the frames, their times and sums, and when to send the next
/// one. An arm brings what takes a frame to the other host.
namespace bench {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;  // one for all network namespaces of a machine

inline std::uint64_t now_ns() {
  return static_cast<std::uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
          .count());
}

struct Settings {
  std::string role;  ///< send, receive
  std::string topic;
  std::string board;  ///< the file of the Board
  std::uint64_t bytes = 1024;
  std::uint64_t frames = 100;
  std::uint64_t warm_up = 10;   ///< of these, at the beginning
  std::uint64_t period_us = 0;  ///< 0: as fast as the window allows
  std::uint32_t depth = 16;     ///< of the queue, and of KEEP_LAST
  std::uint64_t window = 8;     ///< frames that are under way at most
  std::uint32_t readers = 1;    ///< the sender: that it waits for
  std::uint32_t reader = 0;     ///< the receiver: which of them it is
};
constexpr std::uint32_t kMostReaders = 2;

/// What sender and receivers know of each other, in a file that both have mapped: so nothing of it
/// uses the network. Zero bytes are a run that has not begun.
class Board {
 public:
  explicit Board(const std::string& file) {
    const int fd = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (fd < 0 || ftruncate(fd, kBytes) != 0) throw std::runtime_error(file);
    void* const at = mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    if (at == MAP_FAILED) throw std::runtime_error(file);
    words_ = static_cast<Words*>(at);
  }
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;
  ~Board() { munmap(words_, kBytes); }

  /// A receiver: a frame without a number has come.
  void connected(std::uint32_t reader) { set(words_[reader].is_connected, 1); }
  /// A receiver: it has used all frames before `next`.
  void used(std::uint32_t reader, std::uint64_t next) {
    set(words_[reader].used, static_cast<std::uint32_t>(next));
  }

  /// The sender: whether this reader has called connected(), at the latest 20 ms from now.
  bool is_connected(std::uint32_t reader) { return wait(words_[reader].is_connected, 1, 20ms); }
  /// The sender: until this reader has used `count` frames. False: it has not for 10 s.
  bool has_used(std::uint32_t reader, std::uint64_t count) {
    return wait(words_[reader].used, static_cast<std::uint32_t>(count), 10s);
  }

 private:
  using Word = std::atomic<std::uint32_t>;
  struct Words {
    Word is_connected;
    Word used;
  };
  static constexpr std::size_t kBytes = kMostReaders * sizeof(Words);

  static void set(Word& word, std::uint32_t value) {
    word.store(value, std::memory_order_release);
    syscall(SYS_futex, &word, FUTEX_WAKE, 1, nullptr, nullptr, 0);
  }
  static bool wait(Word& word, std::uint32_t least, std::chrono::nanoseconds most) {
    const auto until = Clock::now() + most;
    for (;;) {
      const std::uint32_t seen = word.load(std::memory_order_acquire);
      if (seen >= least) return true;
      const auto left = std::chrono::nanoseconds(until - Clock::now()).count();
      if (left <= 0) return false;
      const timespec time{left / 1'000'000'000, left % 1'000'000'000};
      syscall(SYS_futex, &word, FUTEX_WAIT, seen, &time, nullptr, 0);
    }
  }

  Words* words_ = nullptr;  ///< of each reader
};

/// A frame that only shows that the way is open, and has so many bytes.
constexpr std::uint64_t kNoNumber = ~std::uint64_t{0};
constexpr std::uint64_t kNoNumberBytes = 8;

inline void fill(std::uint8_t* data, std::uint64_t bytes, std::uint64_t number) {
  std::memset(data, static_cast<int>(number & 0xff), bytes);
}

/// Sums the words of a frame's data. Throws where they are not those of fill().
inline void use(const std::uint8_t* data, std::uint64_t bytes, std::uint64_t number) {
  std::uint64_t sum = 0;
  for (std::uint64_t i = 0; i + 8 <= bytes; i += 8) {
    std::uint64_t word = 0;
    std::memcpy(&word, data + i, 8);
    sum += word;
  }
  if (sum != bytes / 8 * (0x0101010101010101ULL * (number & 0xff))) {
    throw std::runtime_error("frame " + std::to_string(number) + " is damaged");
  }
}

/// Sends frames by `send(number, bytes)`, which fills, stamps and sends one.
template <class Send>
void send_all(const Settings& settings, Send&& send) {
  Board board(settings.board);
  const auto all_have_used = [&](std::uint64_t count) {
    for (std::uint32_t r = 0; r < settings.readers; ++r) (void)board.has_used(r, count);
  };
  for (std::uint32_t r = 0; r < settings.readers; ++r) {
    while (!board.is_connected(r)) send(kNoNumber, kNoNumberBytes);
  }
  const auto begin = Clock::now();
  for (std::uint64_t n = 0; n < settings.frames; ++n) {
    if (settings.period_us != 0) {
      std::this_thread::sleep_until(begin + n * std::chrono::microseconds(settings.period_us));
    }
    if (n >= settings.window) all_have_used(n - settings.window + 1);
    send(n, settings.bytes);
  }
  all_have_used(settings.frames);
}

/// What a receiver has seen. It prints one line of JSON.
class Receipt {
 public:
  explicit Receipt(const Settings& settings) : settings_(settings), board_(settings.board) {
    latencies_.reserve(settings.frames);
  }

  /// A frame has come, just now. False: it was the last one.
  bool take(std::uint64_t number, std::uint64_t stamp_ns, const std::uint8_t* data,
            std::uint64_t bytes) {
    const std::uint64_t now = now_ns();
    use(data, bytes, number);
    if (number == kNoNumber) {
      board_.connected(settings_.reader);
      return true;
    }
    if (bytes != settings_.bytes || number >= settings_.frames) throw std::runtime_error("size");
    if (number >= settings_.warm_up) {
      latencies_.push_back(static_cast<double>(now - stamp_ns) / 1e3);
      last_ns_ = now_ns();
    } else {
      first_ns_ = now_ns();
    }
    board_.used(settings_.reader, number + 1);
    return number + 1 != settings_.frames;
  }

  void print() const {
    const std::uint64_t wanted = settings_.frames - settings_.warm_up;
    const double seconds = static_cast<double>(last_ns_ - first_ns_) / 1e9;
    const double megabytes =
        static_cast<double>(latencies_.size()) * static_cast<double>(settings_.bytes) / 1e6;
    const nlohmann::json said{{"latencies_us", latencies_},
                              {"lost", wanted - latencies_.size()},
                              {"mb_per_s", megabytes / seconds}};
    std::printf("%s\n", said.dump().c_str());
  }

 private:
  const Settings& settings_;
  Board board_;
  std::vector<double> latencies_;
  std::uint64_t first_ns_ = 0;  ///< when the last frame of the warm-up was used
  std::uint64_t last_ns_ = 0;
};

/// The main() of an arm.
template <class Work>
int main_of(int argc, char** argv, const char* name, Work&& work) {
  CLI::App app("An arm of bench/gateway/hop.py", name);
  Settings settings;
  app.add_option("role", settings.role)->required();
  app.add_option("topic", settings.topic)->required();
  app.add_option("board", settings.board)->required();
  app.add_option("--bytes", settings.bytes);
  app.add_option("--frames", settings.frames);
  app.add_option("--warm-up", settings.warm_up)->check(CLI::Range(1, 1'000'000));
  app.add_option("--period-us", settings.period_us);
  app.add_option("--depth", settings.depth)->check(CLI::Range(1, 1024));
  app.add_option("--window", settings.window)->check(CLI::Range(1, 64));
  app.add_option("--readers", settings.readers)->check(CLI::Range(1U, kMostReaders));
  app.add_option("--reader", settings.reader)->check(CLI::Range(0U, kMostReaders - 1));
  CLI11_PARSE(app, argc, argv);
  try {
    work(settings);
    return 0;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s: %s\n", name, e.what());
    return 1;
  }
}

}  // namespace bench
