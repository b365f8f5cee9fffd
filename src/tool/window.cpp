// SPDX-License-Identifier: Apache-2.0
#include "tool/window.hpp"

#include <sys/mman.h>
#include <unistd.h>

namespace lot::tool {
namespace {

Window* first_window = nullptr;             ///< the signal handler reads it
volatile std::sig_atomic_t is_opening = 0;  ///< and this

}  // namespace

Window::Opening::Opening() {
  struct sigaction action {};
  action.sa_sigaction = &on_bus_error;
  action.sa_flags = SA_SIGINFO;
  sigaction(SIGBUS, &action, nullptr);
  is_opening = 1;
}
Window::Opening::~Opening() { is_opening = 0; }

segment::Segment Window::open(const std::string& path, const segment::Trust& trust) {
  const Opening opening;
  return segment::Segment(path, segment::Segment::Access::ReadOnly, trust);
}

Window::Window(const std::string& path, const segment::Trust& trust)
    : segment_(open(path, trust)), next_(first_window) {
  first_window = this;
}

Window::~Window() {
  for (Window** w = &first_window; *w != nullptr; w = &(*w)->next_) {
    if (*w != this) continue;
    *w = next_;
    break;
  }
}

void Window::on_bus_error(int signal, siginfo_t* info, void*) {
  auto* const address = static_cast<unsigned char*>(info->si_addr);
  Window* w = first_window;
  const auto is_in = [address](Window* x) {
    const unsigned char* const base = x->segment_.base();
    return address >= base && address < base + x->segment_.size();
  };
  while (w != nullptr && !is_in(w)) w = w->next_;
  if (w != nullptr || is_opening != 0) {
    const auto page = static_cast<std::size_t>(getpagesize());
    unsigned char* const begin = address - reinterpret_cast<std::uintptr_t>(address) % page;
    if (mmap(begin, page, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1, 0) == begin) {
      if (w != nullptr) w->torn_ = true;
      return;
    }
  }
  ::signal(signal, SIG_DFL);  // not a page of ours: the signal comes again and ends the process
}

}  // namespace lot::tool
