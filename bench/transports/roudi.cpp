// SPDX-License-Identifier: Apache-2.0
#include "roudi.hpp"

#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <iceoryx_hoofs/log/logmanager.hpp>
#include <iceoryx_posh/internal/roudi/roudi.hpp>
#include <iceoryx_posh/mepoo/mepoo_config.hpp>
#include <iceoryx_posh/mepoo/segment_config.hpp>
#include <iceoryx_posh/roudi/iceoryx_roudi_components.hpp>

namespace {

/// Its socket is bound by a thread of its own, and a file of an earlier one may lie there.
void wait_until_it_answers() {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strcpy(address.sun_path, ab::kRoudiSocket);
  for (;;) {
    const int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    const int error = connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address);
    close(fd);
    if (error == 0) return;
    usleep(1000);
  }
}

}  // namespace

/// lot_ab_roudi PARENT SIZE:COUNT...
///
/// iceoryx's daemon, for the transport `iceoryx` alone: chunks of these sizes, rising. Writes one
/// byte to descriptor 3 when it answers; ends on SIGTERM, which it also gets when its parent
/// dies, and then leaves nothing behind.
int main(int argc, char** argv) {
  sigset_t end;
  sigemptyset(&end);
  sigaddset(&end, SIGTERM);
  sigprocmask(SIG_BLOCK, &end, nullptr);
  signal(SIGINT, SIG_IGN);  // the parent ends it, after the nodes
  signal(SIGPIPE, SIG_IGN);
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (argc < 3 || getppid() != std::atoi(argv[1])) return 2;

  iox::mepoo::MePooConfig pools;
  for (int i = 2; i < argc; ++i) {
    char* colon = nullptr;
    const unsigned long size = std::strtoul(argv[i], &colon, 10);
    if (*colon != ':') return 2;
    pools.addMemPool({static_cast<std::uint32_t>(size),
                      static_cast<std::uint32_t>(std::strtoul(colon + 1, nullptr, 10))});
  }
  const auto group = iox::posix::PosixGroup::getGroupOfCurrentProcess().getName();
  iox::RouDiConfig_t config;
  config.m_sharedMemorySegments.emplace_back(group, group, pools);

  iox::log::LogManager::GetLogManager().SetDefaultLogLevel(iox::log::LogLevel::kError,
                                                           iox::log::LogLevelOutput::kHideLogLevel);
  iox::roudi::IceOryxRouDiComponents parts(config);
  // No monitoring: a machine that is busy measuring must not make the living look dead.
  iox::roudi::RouDi roudi(
      parts.rouDiMemoryManager, parts.portManager,
      iox::roudi::RouDi::RoudiStartupParameters(iox::roudi::MonitoringMode::OFF, false));
  wait_until_it_answers();
  if (write(ab::kRoudiReadyFd, "+", 1) != 1) return 1;

  int signal_number = 0;
  sigwait(&end, &signal_number);
  // Not by its destructors: they abort, and leave files, when a node was killed while it had a
  // lock.
  for (const std::string& file : ab::roudi_files()) unlink(file.c_str());
  _exit(0);
}
