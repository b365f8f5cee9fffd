// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "lot/detail/core.hpp"
#include "lot/message.hpp"
#include "lot/queue.hpp"
#include "lot/type_identity.hpp"

/// What client and server of a service have in common: their messages and topics.
namespace lot::detail {

/// Which call a client waits for. Each request of the client refers to its ticket.
struct Ticket {
  std::atomic<std::uint64_t> waits_for{0};  ///< the number of the call; 0: none
};

/// A request, in the queue of all clients of the service.
template <class Request>
struct Call {
  std::uint64_t client;
  std::uint64_t number;  ///< counts the calls of that client, from 1
  bool may_retry;        ///< another server may begin anew
  ShmRef<const Ticket> ticket;
  Request request;
};

/// The answer to a call, on the topic of its client.
template <class Response>
struct Answer {
  std::uint64_t number;
  bool has_given_up;  ///< the server at work has died, and no other one is to begin anew
  bool has_failed;    ///< its handler has thrown `error`
  ShmString error;
  Response response;
};

/// What a server says of itself: its type is the one that all ends of the service must have.
template <class Request, class Response>
struct Serving {
  std::uint64_t is_there;
  // Always null: so the description of the type has theirs, and all ends have the same ones.
  ShmRef<const Request> request{};
  ShmRef<const Response> response{};
};

/// The topics of a service.
class ServiceNames {
 public:
  /// Throws lot::Error (EINVAL) for a name of no or over 170 bytes.
  ServiceNames(std::string_view name, std::uint64_t client);

  const std::string& name() const noexcept { return name_; }
  std::uint64_t client() const noexcept { return client_; }
  std::string calls() const { return name_ + "/calls"; }
  std::string presence() const { return name_ + "/servers"; }
  std::string answers() const { return name_ + "/answers/" + std::to_string(client_); }

 private:
  std::string name_;
  std::uint64_t client_;
};

/// A random number: no other client has it.
std::uint64_t new_client();

/// Calls what(); the text of what it throws, or nothing. Of std::bad_alloc, too.
std::optional<std::string> failure_of(void (*call)(void*), void* what);
template <class What>
std::optional<std::string> failure_of(What&& what) {
  return failure_of([](void* w) { (*static_cast<std::remove_reference_t<What>*>(w))(); },
                    const_cast<void*>(static_cast<const void*>(&what)));
}

/// Throw lot::Error: EREMOTEIO, EINVAL, EIO.
[[noreturn]] void raise_failed_call(const std::string& service, const char* text);
[[noreturn]] void raise_no_request(const std::string& service);
[[noreturn]] void raise_no_answer(const std::string& service, const std::string& text);

/// The queue of the requests of a service: one server takes each, and another one gets it when that
/// one has died.
template <class T>
ShmQueue<ShmUniquePtr<T>> make_calls(const std::shared_ptr<transport::Participant>& participant,
                                     const std::string& name, Wait wait) {
  QueueOptions options;
  options.redeliver = true;
  PusherOptions putting;
  putting.depth = 16;
  putting.policy = Policy::Block;
  PullerOptions popping;
  popping.wait = wait;
  return ShmQueue<ShmUniquePtr<T>>(make_queue(participant, name,
                                              queue_type<ShmUniquePtr<T>>(options), putting,
                                              popping, delivery_of<ShmUniquePtr<T>>(options)));
}

}  // namespace lot::detail

namespace lot {

/// The ends of a service compare the types of requests and answers as those of a topic do.
template <class Request>
struct TypeIdentity<detail::Call<Request>> {
  static const char* name() {
    static const auto* const name =
        new std::string(std::string("lot::Call<") + TypeIdentity<Request>::name() + ">");
    return name->c_str();
  }
  static constexpr std::uint64_t hash() { return TypeIdentity<Request>::hash(); }
};
template <class Response>
struct TypeIdentity<detail::Answer<Response>> {
  static const char* name() {
    static const auto* const name =
        new std::string(std::string("lot::Answer<") + TypeIdentity<Response>::name() + ">");
    return name->c_str();
  }
  static constexpr std::uint64_t hash() { return TypeIdentity<Response>::hash(); }
};
template <class Request, class Response>
struct TypeIdentity<detail::Serving<Request, Response>> {
  static const char* name() {
    static const auto* const name =
        new std::string(std::string("lot::Service<") + TypeIdentity<Request>::name() + ", " +
                        TypeIdentity<Response>::name() + ">");
    return name->c_str();
  }
  static constexpr std::uint64_t hash() {
    return TypeIdentity<Request>::hash() * 31 + TypeIdentity<Response>::hash() +
           (sizeof(Request) * 31 + sizeof(Response));
  }
};

}  // namespace lot
