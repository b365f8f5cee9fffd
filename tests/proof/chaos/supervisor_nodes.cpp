// SPDX-License-Identifier: Apache-2.0
/// The supervisor's processes: how they are started, stopped and ended, and who is stuck.
#include <algorithm>
#include <cstdio>
#include <sys/wait.h>
#include <unistd.h>
#include <utility>

#include "node.hpp"
#include "stuck.hpp"
#include "supervisor.hpp"

namespace lot::chaos {

using namespace std::chrono_literals;

namespace {

using Clock = std::chrono::steady_clock;

constexpr auto kLookPeriod = 100ms;
constexpr auto kAimTime = 3ms;

}  // namespace

void Supervisor::start(unsigned slot) {
  Slot& s = slots_[slot];
  NodeRecord& record = board_.nodes[slot];
  const std::uint32_t life = record.life.load() + 1;
  record.doing.store(0);
  record.reached.store(0);
  for (auto& n : record.pushers) n.store(0);
  for (auto& n : record.pullers) n.store(0);
  for (auto& n : record.observers) n.store(0);
  record.life.store(life);
  record.doomed.store(0, std::memory_order_release);
  const bool spared =
      std::find(plan_.spared.begin(), plan_.spared.end(), slot) != plan_.spared.end();
  s = Slot{};
  s.fate = fate_of(settings_.seed, slot, life, spared);
  s.beats = record.beats.load();
  s.pid = namespaces_.fork();
  if (s.pid == 0) _exit(run_node(board_, settings_, epoch_, slot));
  s.born = s.moved = Clock::now();
  ++tally_.lives;
  if (s.fate.stopped) {
    s.next = Next::Stop;
    s.next_at = s.born + s.fate.stop_at;
  } else {
    schedule_end(s, s.born);
  }
}

/// Nothing when there is no process: kill(-1) would mean every one there is.
void Supervisor::send(const Slot& s, int signal) {
  if (s.pid > 0) ::kill(s.pid, signal);
}

void Supervisor::schedule_end(Slot& s, Time from) {
  s.next = s.fate.end == Fate::End::Kill    ? Next::Kill
           : s.fate.end == Fate::End::Leave ? Next::Leave
                                            : Next::Nothing;
  s.next_at = from + s.fate.at;
}

void Supervisor::act(unsigned slot, Time now) {
  Slot& s = slots_[slot];
  switch (s.next) {
    case Next::Kill:
      if (s.fate.aim && !s.stopped) aim(slot);
      kill(slot);
      break;
    case Next::Leave:
      leave(slot);
      if (s.fate.killed_while_leaving) {
        s.next = Next::Kill;
        s.next_at = now + s.fate.leave_for;
      }
      break;
    case Next::Stop:
      send(s, SIGSTOP);
      s.stopped = true;
      s.next = s.fate.killed_while_stopped ? Next::Kill : Next::Continue;
      s.next_at = now + s.fate.stop_for;
      break;
    case Next::Continue:
      resume(s);
      schedule_end(s, s.born);
      break;
    case Next::Nothing:
      break;
  }
}

/// Waits, without sleeping, until the node is seen to do what its killer has chosen.
void Supervisor::aim(unsigned slot) const {
  const auto until = Clock::now() + kAimTime;
  const auto wanted = static_cast<std::uint32_t>(*slots_[slot].fate.aim);
  while (board_.nodes[slot].doing.load(std::memory_order_relaxed) >> 16 != wanted &&
         Clock::now() < until) {
  }
}

void Supervisor::kill(unsigned slot) {
  board_.nodes[slot].doomed.store(1, std::memory_order_release);
  send(slots_[slot], SIGKILL);
  slots_[slot].killed = true;
  slots_[slot].next = Next::Nothing;
}

void Supervisor::leave(unsigned slot) {
  send(slots_[slot], SIGTERM);
  slots_[slot].leaving = true;
  slots_[slot].next = Next::Nothing;
}

void Supervisor::resume(Slot& s) {
  if (!s.stopped || s.pid == -1) return;
  send(s, SIGCONT);
  s.stopped = false;
  s.moved = Clock::now();
}

void Supervisor::pump(Time until) {
  const auto left = std::max<Clock::duration>(until - Clock::now(), 0ns);
  const timespec timeout{std::chrono::duration_cast<std::chrono::seconds>(left).count(),
                         std::chrono::nanoseconds(left % 1s).count()};
  siginfo_t info{};
  const int s = sigtimedwait(&signals_, &info, &timeout);
  if (s == SIGINT || s == SIGTERM || s == SIGHUP) {
    std::printf("interrupted by signal %d of process %d\n", s, static_cast<int>(info.si_pid));
    interrupted_ = true;
  }
  collect_ended();
  const auto now = Clock::now();
  if (now - looked_ >= kLookPeriod) look_for_stuck(now);
}

void Supervisor::collect_ended() {
  int status = 0;
  for (pid_t pid; (pid = waitpid(-1, &status, WNOHANG)) > 0;) {
    if (pid == last_.pid) {
      last_.pid = -1;
      last_status_ = status;
      continue;
    }
    for (unsigned slot = 0; slot < slots_.size(); ++slot) {
      if (slots_[slot].pid != pid) continue;
      slots_[slot].pid = -1;
      ended(slot, status);
      break;
    }
  }
  for (unsigned slot = 0; slot < slots_.size() && restart_ && !interrupted_; ++slot) {
    if (slots_[slot].pid == -1) start(slot);
  }
}

void Supervisor::ended(unsigned slot, int status) {
  const Slot& s = slots_[slot];
  const std::uint32_t doing = board_.nodes[slot].doing.load();
  hands_.ended(slot);
  if (s.killed && WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) {
    ++tally_.kills;
    Tally::Kills& k = tally_.kills_while[doing >> 16];
    k.first_moments += Clock::now() - s.born < kFirstMoments + 1ms;
    k.later += Clock::now() - s.born >= kFirstMoments + 1ms;
    k.stopped += s.stopped;
    return;
  }
  const int code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  if (code == kFaulty || interrupted_) return;
  if (code == kNoRoom && !epoch_.roomy) {
    ++tally_.no_room;
  } else if (code == kStalled) {
    ++tally_.gave_up;
  } else if (code == kLeft && s.leaving) {
    ++tally_.left;
  } else {
    board_.report(Finding::Crashed, slot,
                  (code >= 0 ? "ended by itself with status " + std::to_string(code)
                             : "ended by signal " + std::to_string(WTERMSIG(status))) +
                      " while " + kDoingNames[doing >> 16] + " " + kTopic[doing & 0xffff].name);
  }
}

void Supervisor::look_for_stuck(Time now) {
  const auto since = now - std::exchange(looked_, now);
  // While the machine stands still nobody is to blame.
  const bool stalls = canary_.machine_stalls();
  if (stalls) tally_.stood_still += since;
  for (unsigned slot = 0; slot < slots_.size(); ++slot) {
    Slot& s = slots_[slot];
    if (s.pid <= 0 || s.stopped) continue;
    const std::uint64_t beats = board_.nodes[slot].beats.load();
    if (beats != s.beats || stalls) {
      s.beats = beats;
      s.moved = now;
    } else if (now - s.moved > settings_.patience) {
      stuck(slot, "makes no progress");
      kill(slot);
    }
  }
}

void Supervisor::stuck(unsigned slot, const char* what) {
  const std::uint32_t doing = board_.nodes[slot].doing.load();
  board_.report(
      Finding::Wedged, slot,
      std::string(what) + ", " + kDoingNames[doing >> 16] + " " + kTopic[doing & 0xffff].name);
  std::printf("  chaos%u, process %d, is here:\n%s", slot, static_cast<int>(slots_[slot].pid),
              where_is(slots_[slot].pid).c_str());
}

/// Waits with all that it takes to keep the nodes going. False: it did not come true in time.
bool Supervisor::pump_until(const std::function<bool()>& condition) {
  const auto begin = Clock::now();
  const auto stalled_before = tally_.stood_still;
  while (!condition()) {
    if (over() ||
        Clock::now() - begin > settings_.patience + (tally_.stood_still - stalled_before)) {
      return false;
    }
    pump(Clock::now() + 2ms);
  }
  return true;
}

}  // namespace lot::chaos
