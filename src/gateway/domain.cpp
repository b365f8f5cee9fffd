// SPDX-License-Identifier: Apache-2.0
#include "gateway/domain.hpp"

#include <arpa/inet.h>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>
#include <netinet/in.h>
#include <set>
#include <string_view>

#include <dds/ddsrt/log.h>
#include <ifaddrs.h>

#include "lot/detail/mutex.hpp"
#include "lot/error.hpp"

#include "gateway/rate_limit.hpp"

namespace lot::gateway {
namespace {

/// A reliable writer keeps this much that is not acknowledged, and then waits a moment. It is so
/// much that as a rule the last samples of a topic push older ones out before that.
constexpr const char* kUnacknowledged = "256 MB";

/// What is asked for. The system gives less, where net.core.rmem_max is less.
constexpr const char* kSocketBytes = "32 MB";

/// By this ROS 2 knows participants that have nodes.
constexpr std::string_view kOfRos = "enclave=/;";

std::string escaped(const std::string& text) {
  std::string result;
  for (const char c : text) {
    switch (c) {
      case '&':
        result += "&amp;";
        break;
      case '<':
        result += "&lt;";
        break;
      case '"':
        result += "&quot;";
        break;
      default:
        result += c;
    }
  }
  return result;
}

std::string within_domain(const std::string& elements) {
  return "<CycloneDDS><Domain Id=\"any\">" + elements + "</Domain></CycloneDDS>";
}

bool is_address(const std::string& interface) {
  return interface.find_first_not_of("0123456789.") == std::string::npos;
}

/// Throws lot::Error, with the names that there are, where this machine has no such interface.
void require_interface(const std::string& interface) {
  ifaddrs* first = nullptr;
  if (getifaddrs(&first) != 0) throw Error(errno, interface, "interfaces can not be listed", "");
  const std::unique_ptr<ifaddrs, void (*)(ifaddrs*)> all(first, freeifaddrs);
  std::set<std::string> names;
  for (const ifaddrs* one = first; one != nullptr; one = one->ifa_next) {
    names.insert(one->ifa_name);
    char address[INET_ADDRSTRLEN] = "";
    if (one->ifa_addr != nullptr && one->ifa_addr->sa_family == AF_INET) {
      sockaddr_in its{};
      std::memcpy(&its, one->ifa_addr, sizeof its);
      inet_ntop(AF_INET, &its.sin_addr, address, sizeof address);
    }
    if (interface == one->ifa_name || interface == address) return;
  }
  std::string there;
  for (const std::string& name : names) there += (there.empty() ? "" : ", ") + name;
  throw Error(ENODEV, interface, "this machine has no such network interface",
              "there are " + there);
}

/// Fragments of configuration: the later ones come before the earlier ones.
std::string configuration(const DomainSettings& settings) {
  std::string own = "<Internal><MaxSampleSize>" + std::to_string(settings.max_size) +
                    " B</MaxSampleSize><Watermarks><WhcHigh>" + kUnacknowledged +
                    "</WhcHigh></Watermarks><SocketReceiveBufferSize max=\"" + kSocketBytes +
                    "\"/></Internal>";
  if (!settings.interface.empty()) {
    own += "<General><Interfaces><NetworkInterface " +
           std::string(is_address(settings.interface) ? "address" : "name") + "=\"" +
           escaped(settings.interface) + "\"/></Interfaces></General>";
  }
  std::string all = within_domain(own);
  if (!settings.more.empty()) all += "," + within_domain(settings.more);
  const char* const users = std::getenv("CYCLONEDDS_URI");
  if (users != nullptr && *users != '\0') all += "," + std::string(users);
  return all;
}

/// What CycloneDDS logs goes to standard error: so many lines a second, since the network can make
/// it log.
class Log {
 public:
  static void write(void* self, const dds_log_data_t* line) noexcept {
    static_cast<Log*>(self)->add({line->message, line->size});
  }

 private:
  void add(std::string_view line) noexcept {
    const std::lock_guard guard(mutex_);
    if (!rate_.allows(RateLimit::Clock::now())) {
      ++left_out_;
      return;
    }
    if (left_out_ != 0) std::fprintf(stderr, "CycloneDDS: %lu lines left out\n", left_out_);
    left_out_ = 0;
    while (line.ends_with('\n')) line.remove_suffix(1);
    std::fprintf(stderr, "CycloneDDS: %.*s\n", static_cast<int>(line.size()), line.data());
  }

  static constexpr double kLinesASecond = 5;

  detail::Mutex mutex_{detail::Rank::Gateway};
  RateLimit rate_{kLinesASecond};
  unsigned long left_out_ = 0;
};

/// As long as the process: CycloneDDS may log until its last thread has ended.
Log& log_of_process() {
  static auto* const log = new Log;
  return *log;
}

}  // namespace

Domain::Domain(const DomainSettings& settings) {
  if (!settings.interface.empty()) require_interface(settings.interface);
  dds_set_log_sink(Log::write, &log_of_process());
  const std::string name = "DDS domain " + std::to_string(settings.id);
  domain_ = Entity(dds_create_domain(settings.id, configuration(settings).c_str()), name,
                   "join the domain");
  dds_qos_t* const qos = dds_create_qos();
  dds_qset_userdata(qos, kOfRos.data(), kOfRos.size());
  const dds_entity_t made = dds_create_participant(settings.id, qos, nullptr);
  dds_delete_qos(qos);
  participant_ = Entity(made, name, "make a participant");
}

}  // namespace lot::gateway
