// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/service.hpp"

#include <cerrno>
#include <exception>
#include <random>

#include "lot/error.hpp"

namespace lot::detail {

ServiceNames::ServiceNames(std::string_view name, std::uint64_t client)
    : name_(name), client_(client) {
  constexpr std::size_t kLongest = 170;  // so that the names of its topics are topics' names
  static_assert(kLongest + std::string_view("/answers/18446744073709551615").size() <
                kTopicNameBytes);
  if (!name.empty() && name.size() <= kLongest) return;
  throw Error(EINVAL, name_, "a service cannot have this name", "use 1 to 170 bytes");
}

std::uint64_t new_client() {
  std::random_device random;
  return (std::uint64_t{random()} << 32) | random();
}

std::optional<std::string> failure_of(void (*call)(void*), void* what) {
  try {
    call(what);
  } catch (const std::exception& e) {
    return e.what();
  } catch (...) {
    return "the handler has thrown what is no std::exception";
  }
  return std::nullopt;
}

void raise_failed_call(const std::string& service, const char* text) {
  throw Error(EREMOTEIO, service, std::string("the server's handler has failed: ") + text,
              "look at the server");
}

void raise_no_request(const std::string& service) {
  throw Error(EINVAL, service, "a request was sent twice", "loan() a new one for each call");
}

void raise_no_answer(const std::string& service, const std::string& text) {
  throw Error(EIO, service, "a request cannot be answered: " + text,
              "its client waits to its time-out");
}

}  // namespace lot::detail
