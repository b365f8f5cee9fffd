// SPDX-License-Identifier: Apache-2.0

// A process that ends in the way that it is told, with everything alive.
//
//     ending HOW DIRECTORY SEGMENT

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <dirent.h>
#include <exception>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include "lot/lot.hpp"

namespace ending {

using namespace std::chrono_literals;

struct Number {
  std::uint64_t value;
  lot::ShmString text;
};

void require(bool condition, const char* what) {
  if (!condition) throw std::runtime_error(what);
}
void must_go(lot::Status status) { require(status == lot::Status::Ok, "a message goes"); }

/// What a program of this library may have.
struct Handles {
  std::optional<lot::ShmEngine> engine;
  std::optional<lot::ShmPusher<Number>> pusher;
  std::optional<lot::ShmPuller<Number>> puller;
};
struct Pointers {
  lot::ShmUniquePtr<Number> loaned;
  lot::ShmSharedPtr<Number> made;
  lot::ShmSharedPtr<const Number> kept;
  lot::ShmWeakPtr<const Number> weak;
};

void fill(Handles& handles, Pointers& pointers, const lot::EngineOptions& options) {
  handles.engine.emplace(options);
  handles.pusher.emplace(handles.engine->advertise<Number>("/t"));
  handles.puller.emplace(handles.engine->subscribe<Number>("/t"));
  for (std::uint64_t n = 0; n < 3; ++n) {
    auto number = handles.pusher->loan();
    number->value = n;
    number->text = "a text that is much too long for the small string in place";
    must_go(handles.pusher->push(std::move(number)));
  }
  pointers.kept = handles.puller->pull(10s);
  require(pointers.kept && pointers.kept->value == 0, "what was pushed");
  pointers.weak = pointers.kept;
  pointers.loaned = handles.pusher->loan();
  pointers.made = handles.engine->make<Number>();
}

Handles& static_handles() {
  static Handles handles;
  return handles;
}
Pointers& static_pointers() {
  static Pointers pointers;
  return pointers;
}

/// Publishes when everything else has been destroyed.
struct Late {
  struct WithANameThatIsNotShort {
    std::uint64_t value;
  };
  lot::EngineOptions options;

  void publish() const {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<WithANameThatIsNotShort>("/late");
    auto puller = engine.subscribe<WithANameThatIsNotShort>("/late");
    must_go(pusher.push(pusher.loan(std::uint64_t{5})));
    require(puller.try_pull()->value == 5, "what was pushed");
    require(std::strcmp(lot::TypeIdentity<WithANameThatIsNotShort>::name(),
                        "ending::Late::WithANameThatIsNotShort") == 0,
            "the name of the type");
  }
  ~Late() {
    try {
      publish();
    } catch (const std::exception& e) {
      std::fprintf(stderr, "at the end: %s\n", e.what());
      _exit(3);
    }
  }
};

/// Publishes until the process ends.
void publish_for_ever(Handles& handles) {
  for (;;) must_go(handles.pusher->push(handles.pusher->loan()));
}

/// Closes rings until the process ends: most of the time it acts for the orphanage.
void close_for_ever(Handles& handles) {
  for (;;) (void)handles.engine->advertise<Number>("/closed");
}

/// Open files of this process that belong to the segment.
int files_of(const std::string& segment) {
  int n = 0;
  DIR* directory = opendir("/proc/self/fd");
  while (const dirent* entry = readdir(directory)) {
    char target[4096] = {};
    const std::string link = std::string("/proc/self/fd/") + entry->d_name;
    if (readlink(link.c_str(), target, sizeof(target) - 1) > 0) {
      n += std::strstr(target, segment.c_str()) != nullptr;
    }
  }
  closedir(directory);
  return n;
}

/// A process of another program, as system() makes one.
int run(const char* program, const char* how, const lot::EngineOptions& options) {
  const pid_t child = vfork();
  if (child == 0) {
    execl(program, program, how, options.directory.c_str(), options.segment.c_str(), nullptr);
    _exit(127);
  }
  int status = 0;
  waitpid(child, &status, 0);
  return status;
}

std::atomic<bool> raises_late{false};
std::atomic<bool> is_raising{false};

void say(const char* word) {
  std::puts(word);
  std::fflush(stdout);
}

/// Forks while the library ends the process, which has no segment yet. A child would have its locks
/// as they are just then.
[[noreturn]] void fork_at_the_end() {
  raises_late = true;
  say("ready.");
  while (!is_raising) std::this_thread::sleep_for(1ms);
  if (fork() == 0) {
    say("a child");
    _exit(0);
  }
  for (;;) pause();
}

}  // namespace ending

/// In the place of the C library's: by it the process ends itself.
extern "C" int raise(int number) noexcept {
  if (ending::raises_late) {
    ending::is_raising = true;
    std::this_thread::sleep_for(std::chrono::seconds(1));  // time to fork in
  }
  return static_cast<int>(syscall(SYS_tgkill, getpid(), gettid(), number));
}

namespace ending {

/// Says "ready", and waits for a signal.
int end_by_signal(const std::string& how, lot::EngineOptions options) {
  if (how == "signals, ignored") std::signal(SIGINT, SIG_IGN);
  lot::end_cleanly_on_signals();
  lot::end_cleanly_on_signals();  // once more does no harm
  if (how == "signals, and it forks meanwhile") fork_at_the_end();
  options.persist = how == "signals, persist";
  auto& handles = *new Handles;
  fill(handles, *new Pointers, options);
  if (how == "signals while threads publish") {
    for (int i = 0; i < 3; ++i) std::thread([&] { publish_for_ever(handles); }).detach();
  }
  if (how == "signals while a thread closes rings") {
    std::thread([&] { close_for_ever(handles); }).detach();
  }
  if (how == "signals, with a child") {
    const pid_t child = fork();
    if (child == 0) {
      pause();
      _exit(4);
    }
    kill(child, SIGTERM);
    int status = 0;
    require(
        waitpid(child, &status, 0) == child && WIFSIGNALED(status) && WTERMSIG(status) == SIGTERM,
        "in a child the signal acts as by default");
    require(access((options.directory + "/" + options.segment).c_str(), F_OK) == 0,
            "and leaves the parent's files");
  }
  if (how == "signals, ignored") raise(SIGINT);
  if (how == "signals after closefrom") {
    for (int fd = 3; fd < 100; ++fd) close(fd);
  }
  sigset_t all, before;
  sigfillset(&all);
  sigemptyset(&before);
  if (how == "signals, and main() returns") sigprocmask(SIG_SETMASK, &all, &before);
  say("ready.");
  if (how == "signals, and main() returns") {
    sigsuspend(&before);
    return 1;
  }
  for (;;) pause();
}

int end(const std::string& how, const lot::EngineOptions& options, const char* program) {
  if (how == "sleep") {  // what exec() has made of the process
    require(files_of(options.segment) == 0, "nothing was inherited");
    say("asleep");
    pause();
  }
  if (how == "look") return files_of(options.segment);
  if (how == "statics, pointers last") {
    static_pointers();
    fill(static_handles(), static_pointers(), options);
    return 0;
  }
  if (how == "statics, handles last") {
    static_handles();
    fill(static_handles(), static_pointers(), options);
    return 0;
  }
  if (how == "publish in a static destructor") {
    static const Late late{options};
    late.publish();
    return 0;
  }
  const bool signals = how.rfind("signals", 0) == 0;
  if (signals) return end_by_signal(how, options);
  auto& handles = *new Handles;
  auto& pointers = *new Pointers;
  fill(handles, pointers, options);
  if (how == "return") return 0;
  if (how == "exit") std::exit(0);
  if (how == "_exit") _exit(0);
  if (how == "quick_exit") std::quick_exit(0);
  if (how == "abort") std::abort();
  if (how == "exit in a thread") {
    std::thread([] { std::exit(0); }).join();
  }
  if (how == "exit while threads publish") {
    for (int i = 0; i < 3; ++i) std::thread([&] { publish_for_ever(handles); }).detach();
    std::this_thread::sleep_for(50ms);
    std::exit(0);
  }
  if (how == "exec while threads publish") {
    for (int i = 0; i < 3; ++i) std::thread([&] { publish_for_ever(handles); }).detach();
    std::this_thread::sleep_for(50ms);
  }
  if (how == "exec in a thread") {
    std::thread([&] {
      execl(program, program, "sleep", options.directory.c_str(), options.segment.c_str(), nullptr);
    }).join();
  }
  if (how == "exec" || how == "exec while threads publish") {
    execl(program, program, "sleep", options.directory.c_str(), options.segment.c_str(), nullptr);
  }
  if (how == "start another program") {
    require(files_of(options.segment) > 0, "its own files are open");
    require(run(program, "look", options) == 0, "the other program has inherited none");
    require(pointers.kept->value == 0, "what was kept");
    must_go(handles.pusher->push(std::move(pointers.loaned)));
    return 0;
  }
  throw std::runtime_error("no such end: " + how);
}

}  // namespace ending

int main(int argc, char** argv) {
  alarm(60);
  try {
    ending::require(argc == 4, "usage: ending HOW DIRECTORY SEGMENT");
    lot::EngineOptions options;
    options.directory = argv[2];
    options.segment = argv[3];
    return ending::end(argv[1], options, argv[0]);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "ending %s: %s\n", argc > 1 ? argv[1] : "", e.what());
    return 1;
  }
}
