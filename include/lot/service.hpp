// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <iterator>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <unordered_map>
#include <utility>

#include "lot/compliance.hpp"
#include "lot/detail/core.hpp"
#include "lot/detail/message_type.hpp"
#include "lot/detail/service.hpp"
#include "lot/duration.hpp"
#include "lot/error.hpp"
#include "lot/message.hpp"
#include "lot/pointers.hpp"
#include "lot/puller.hpp"
#include "lot/pusher.hpp"
#include "lot/queue.hpp"
#include "lot/stop_token.hpp"
#include "lot/wait_set.hpp"

namespace lot {

/// How a client asks.
struct ClientOptions {
  Wait wait = Wait::Adaptive;  ///< how a call passes the time
  /// What becomes of a request whose server dies at work, while the service has another one. True:
  /// that one gets it, so a request may be done more than once; after three deaths the call ends
  /// all the same. False: the call ends with Status::ServerGone.
  bool retry = false;
};

/// How a server waits, and what its thread is.
struct ServerOptions {
  Wait wait = Wait::Adaptive;                 ///< how it passes the time until a request comes
  ThreadOptions thread = named("lot-serve");  ///< how it is seen and scheduled

 private:
  static ThreadOptions named(const char* name) {
    ThreadOptions options;
    options.name = name;
    return options;
  }
};

/// A request that is built in shared memory: see ShmClient::loan().
///
/// Threads: as a std::unique_ptr.
/// Errors:  nothing throws, but a request that grows: lot::OutOfMemory.
/// Memory:  a message of the segment, until it is sent or destroyed.
/// Crash:   another process frees it.
template <class Request>
class ShmRequest {
 public:
  ShmRequest() noexcept = default;
  /// For ShmClient.
  explicit ShmRequest(ShmUniquePtr<detail::Call<Request>> call) noexcept : call_(std::move(call)) {}

  /// False: it was sent.
  [[nodiscard]] explicit operator bool() const noexcept { return call_ != nullptr; }
  /// The request, to be filled. REQUIRES: there is one.
  Request& operator*() const noexcept { return call_->request; }
  /// A member of it. REQUIRES: there is one.
  Request* operator->() const noexcept { return &call_->request; }

 private:
  template <class Q, class A>
  friend class ShmClient;

  ShmUniquePtr<detail::Call<Request>> call_;
};

/// Asks the servers of a service, one call at a time.
///
///     auto plan = engine.client<Goal, Path>("plan");
///     if (auto path = plan.call(Goal{3, 4}, 1s)) drive(*path);
///     else if (plan.status() == lot::Status::ServerGone) ...
///
/// One server gets a request, and no order says which. The client reads the answer where the server
/// has built it: no copy.
///
/// Threads: one at a time. Each thread makes a client of its own.
/// Errors:  lot::Error: EREMOTEIO with its text when the server's handler has thrown; EINVAL for a
///          request that was sent already; ECHILD, ESTALE, EBUSY and EBADMSG as ShmQueue and
///          ShmPuller. lot::OutOfMemory when the segment has no room for a request, std::bad_alloc
///          when the process has none.
/// Memory:  in the segment a queue with up to 16 requests, and its answers as a ShmPuller has them.
/// Crash:   no server begins with a request whose client has died.
template <class Request, class Response>
class ShmClient {
 public:
  /// For ShmEngine::client(). Throws as that.
  ShmClient(const std::shared_ptr<transport::Participant>& participant, std::string_view name,
            const ClientOptions& options)
      : core_(std::make_unique<Core>(participant, name, options)) {}

  /// A request that is built in place, to be sent by call(): for what is large. Throws
  /// lot::OutOfMemory, lot::Error as the class says; what the constructor of Request throws.
  [[nodiscard]] ShmRequest<Request> loan() { return ShmRequest<Request>(core_->calls.make()); }

  /// Sends the request and waits for the answer. Null: see status(). It waits for a server where
  /// there is none yet. The request stays with the caller where no server was there to get it.
  /// Throws lot::Error as the class says.
  [[nodiscard]] ShmSharedPtr<const Response> call(ShmRequest<Request>&& request, Duration timeout,
                                                  const StopToken& stop = {}) {
    return core_->call(request.call_, detail::after(timeout), stop);
  }
  /// The same without a limit: it ends when the servers have gone. Throws the same.
  [[nodiscard]] ShmSharedPtr<const Response> call(ShmRequest<Request>&& request,
                                                  const StopToken& stop = {}) {
    return core_->call(request.call_, detail::Clock::time_point::max(), stop);
  }
  /// The same with a copy of a request. Throws the same; what the copy throws.
  [[nodiscard]] ShmSharedPtr<const Response> call(const Request& request, Duration timeout,
                                                  const StopToken& stop = {}) {
    return call_copy(request, detail::after(timeout), stop);
  }
  /// The same with a copy, without a limit. Throws the same.
  [[nodiscard]] ShmSharedPtr<const Response> call(const Request& request,
                                                  const StopToken& stop = {}) {
    return call_copy(request, detail::Clock::time_point::max(), stop);
  }

  /// How the last call ended:
  ///
  ///     Ok            there is an answer, be it that the handler has thrown
  ///     Timeout       none came in time: a server may still be at work
  ///     ServerGone    the server that was to answer has died or left, or no server has come
  ///     HoldsTooMuch  an answer came, and the process may keep no more: let answers go
  ///     Stopped       the StopToken was told to stop
  ///
  /// What comes later, of a call that has ended, is dropped. No server begins with its request.
  Status status() const noexcept { return core_->status; }

  /// Servers that are there now. Throws lot::Error as the class says.
  std::size_t servers() { return core_->presence.publishers(); }
  /// Waits until there is a server. False: the time is up, or it was told to stop. Throws
  /// lot::Error as the class says.
  [[nodiscard]] bool wait_for_server(Duration timeout, const StopToken& stop = {}) {
    return core_->wait_for_server(detail::after(timeout), stop);
  }
  /// The same without a limit. Throws the same.
  [[nodiscard]] bool wait_for_server(const StopToken& stop) {
    return core_->wait_for_server(detail::Clock::time_point::max(), stop);
  }

 private:
  using Call = detail::Call<Request>;
  using Answer = detail::Answer<Response>;
  using Serving = detail::Serving<Request, Response>;

  /// It stays where it is: the WaitSet's handlers point to it.
  struct Core {
    Core(const std::shared_ptr<transport::Participant>& participant, std::string_view name,
         const ClientOptions& options)
        : may_retry(options.retry),
          names(name, detail::new_client()),
          presence(detail::make_puller(participant, names.presence(),
                                       detail::message_type<Serving>(), latched(),
                                       detail::Delivery::ToAll)),
          answers(detail::make_puller(participant, names.answers(), detail::message_type<Answer>(),
                                      {}, detail::Delivery::ToAll)),
          calls(detail::make_calls<Call>(participant, names.calls(), options.wait)),
          maker(detail::make_maker(participant)),
          ticket(detail::build<detail::Ticket>(
              maker->loan(detail::message_type<detail::Ticket>(), true))),
          set(options.wait) {
      set.add(answers, [this] { look_for_answer(); });
      set.add(presence, [this] { see_servers(); });
    }

    ShmSharedPtr<const Response> call(ShmUniquePtr<Call>& request, detail::Clock::time_point until,
                                      const StopToken& stop) {
      if (request == nullptr) detail::raise_no_request(names.name());
      ++number;  // from here on what answers an earlier call is dropped
      answer = nullptr;
      if (!wait_for_server(until, stop)) {
        status = stop.stop_requested() ? Status::Stopped : Status::ServerGone;
        return nullptr;
      }
      look_for_answer();  // makes room for the answer
      status = holds_too_much ? Status::HoldsTooMuch : ask(request, until, stop);
      return status == Status::Ok ? take_answer() : nullptr;
    }

    Status ask(ShmUniquePtr<Call>& request, detail::Clock::time_point until,
               const StopToken& stop) {
      request->client = names.client();
      request->number = number;
      request->may_retry = may_retry;
      request->ticket = ticket;
      // Relaxed, both: putting the request carries it. A server that sees the end of the call late
      // begins with a request for which no client waits.
      ticket->waits_for.store(number, std::memory_order_relaxed);
      const struct End {
        detail::Ticket& ticket;
        ~End() { ticket.waits_for.store(0, std::memory_order_relaxed); }  // relaxed: as above
      } end{*ticket};
      const Status sent = send(request, until, stop);
      return sent == Status::Ok ? wait_for_answer(until, stop) : sent;
    }

    /// Requests of earlier calls may fill the queue, while servers are slow. Looks now and then
    /// whether there are any.
    Status send(ShmUniquePtr<Call>& request, detail::Clock::time_point until,
                const StopToken& stop) {
      for (;;) {
        const auto soon = std::min(until, detail::after(std::chrono::milliseconds(50)));
        const Status sent = calls.put_until(std::move(request), soon, stop);
        if (sent != Status::Full) return sent;
        see_servers();
        if (!has_server) return Status::ServerGone;
        if (soon == until) return Status::Timeout;
      }
    }

    Status wait_for_answer(detail::Clock::time_point until, const StopToken& stop) {
      while (answer == nullptr && !holds_too_much && has_server) {
        if (!wait(until, stop)) {
          if (stop.stop_requested()) return Status::Stopped;
          look_for_answer();  // the wait tells of an answer that may not be kept once a second only
          if (answer == nullptr && !holds_too_much) return Status::Timeout;
        }
      }
      if (answer == nullptr && !has_server) look_for_answer();  // it came before its server's end
      if (answer != nullptr) return answer->has_given_up ? Status::ServerGone : Status::Ok;
      return holds_too_much ? Status::HoldsTooMuch : Status::ServerGone;
    }

    bool wait_for_server(detail::Clock::time_point until, const StopToken& stop) {
      see_servers();
      while (!has_server) {
        if (!wait(until, stop)) return false;
      }
      return !stop.stop_requested();
    }

    /// False: the time is up, or it was told to stop, and nothing has come.
    bool wait(detail::Clock::time_point until, const StopToken& stop) {
      return set.run_once_until(until, stop) != 0;
    }

    /// The first one counts: a server that has answered may die before it has finished the request,
    /// and another one then gives it up.
    void look_for_answer() {
      while (auto came = answers.try_pull()) {
        if (came->number == number && answer == nullptr) answer = std::move(came);
      }
      holds_too_much = answers.status() == Status::HoldsTooMuch;
    }
    void see_servers() {
      while (presence.try_pull()) {
      }
      has_server = presence.publishers() != 0;
    }

    ShmSharedPtr<const Response> take_answer() {
      const ShmSharedPtr<const Answer> mine = std::move(answer);
      if (mine->has_failed) detail::raise_failed_call(names.name(), mine->error.c_str());
      return {mine, &mine->response};
    }

    static PullerOptions latched() {
      PullerOptions options;
      options.history = 1;
      return options;
    }

    const bool may_retry;
    const detail::ServiceNames names;
    ShmPuller<Serving> presence;
    ShmPuller<Answer> answers;
    ShmQueue<ShmUniquePtr<Call>> calls;
    std::unique_ptr<detail::PusherCore> maker;
    ShmSharedPtr<detail::Ticket> ticket;
    WaitSet set;
    std::uint64_t number = 0;           ///< of the call that is made, or was made last
    ShmSharedPtr<const Answer> answer;  ///< to that call
    bool has_server = false;
    bool holds_too_much = false;
    Status status = Status::Empty;
  };

  ShmSharedPtr<const Response> call_copy(const Request& request, detail::Clock::time_point until,
                                         const StopToken& stop) {
    if (stop.stop_requested()) {
      core_->status = Status::Stopped;
      return nullptr;
    }
    auto copy = core_->calls.make(std::uint64_t{0}, std::uint64_t{0}, false,
                                  ShmRef<const detail::Ticket>(), request);
    return core_->call(copy, until, stop);
  }

  std::unique_ptr<Core> core_;
};

/// Answers the requests of a service, on a thread of its own, until it is destroyed: see
/// ShmEngine::serve(). A service may have several, in one process or many: each request goes to one
/// of them. One that was moved from may only be destroyed or assigned to.
///
///     auto server = engine.serve<Goal, Path>("plan", [](const Goal& goal, Path& path) {
///       path.points.resize(1000);           // built in shared memory: no copy
///     });
///
/// Threads: the handler runs on that thread alone. When the server has been destroyed it is not
///          running any more; it must not destroy its own server.
/// Errors:  the client hears of what the handler throws, by a lot::Error. What else keeps this
///          server from answering (no memory, no channel for one more client) goes to
///          ThreadOptions::on_error (EIO, with its text); that client waits to its time-out.
/// Memory:  a thread with its stack; in the segment a queue for each client that it has answered,
///          with an answer in it until the client has read it and the server answers the next one.
/// Crash:   clients that wait for it hear of it at once: see ClientOptions::retry. Requests that it
///          has not begun with go to the other servers.
template <class Request, class Response>
class ShmServer {
 public:
  /// For ShmEngine::serve(). Throws as that.
  template <class Handler>
  ShmServer(const std::shared_ptr<transport::Participant>& participant, std::string_view name,
            Handler&& handler, const ServerOptions& options)
      : core_(std::make_unique<Core>(participant, name, options.wait)),
        listener_(
            *core_->calls.core_,
            [core = core_.get(), handler = std::forward<Handler>(handler)]() mutable {
              core->serve(handler);
            },
            options.wait, options.thread) {
    core_->announce();
  }
  ShmServer(ShmServer&&) noexcept = default;
  ShmServer& operator=(ShmServer&& other) noexcept {
    listener_ = std::move(other.listener_);  // its thread uses what was here
    core_ = std::move(other.core_);
    return *this;
  }

 private:
  using Call = detail::Call<Request>;
  using Answer = detail::Answer<Response>;
  using Serving = detail::Serving<Request, Response>;

  /// Of a request that may go to another server: after so many deaths the call ends.
  static constexpr std::uint32_t kMostServers = 3;

  struct Core {
    Core(std::shared_ptr<transport::Participant> p, std::string_view name, Wait wait)
        : participant(std::move(p)),
          names(name, 0),
          calls(detail::make_calls<Call>(participant, names.calls(), wait)),
          presence(
              detail::make_pusher(participant, names.presence(), detail::message_type<Serving>(),
                                  {}, detail::Delivery::ToAll),
              Duration()) {
      calls.listen();
    }

    /// Clients that wait for a server look then.
    void announce() { (void)presence.push(presence.loan(Serving{1})); }

    template <class Handler>
    void serve(Handler& handler) {
      auto task = calls.try_take();
      if (!task) return;
      const auto failure = detail::failure_of([&] { handle(task, handler); });
      task.finish();  // also then: given back it would be the next one, and again
      if (failure) detail::raise_no_answer(names.name(), *failure);
    }

    template <class Handler>
    void handle(const ShmTask<Call>& task, Handler& handler) {
      ShmPusher<Answer>* const client = client_of(*task);
      if (client == nullptr) return;
      if (task.deliveries() > (task->may_retry ? kMostServers : 1)) {
        give_up(*client, task->number);
      } else {
        answer(*client, *task, handler);
      }
    }

    /// Null: no client waits for the answer.
    ShmPusher<Answer>* client_of(const Call& call) {
      // Relaxed: as in ShmClient.
      if (call.ticket->waits_for.load(std::memory_order_relaxed) != call.number) return nullptr;
      auto known = clients.find(call.client);
      if (known == clients.end()) known = meet(call.client);
      return known->second.readers() != 0 ? &known->second : nullptr;
    }
    auto meet(std::uint64_t client) {
      for (auto c = clients.begin(); c != clients.end();) {
        c = c->second.readers() == 0 ? clients.erase(c) : std::next(c);
      }
      PusherOptions options;
      options.depth = 4;
      options.policy = Policy::Refuse;  // never full: a client reads its answers before it asks
      options.history = 0;
      const detail::ServiceNames its(names.name(), client);
      return clients
          .emplace(client, ShmPusher<Answer>(detail::make_pusher(participant, its.answers(),
                                                                 detail::message_type<Answer>(),
                                                                 options, detail::Delivery::ToAll),
                                             Duration()))
          .first;
    }

    template <class Handler>
    void answer(ShmPusher<Answer>& client, const Call& call, Handler& handler) {
      ShmUniquePtr<Answer> result;
      const auto build = [&] {
        result = loan(client, call.number);
        handler(call.request, result->response);
      };
      if (const auto failure = detail::failure_of(build)) {
        result = nullptr;  // with the memory that it has
        result = loan(client, call.number);
        result->has_failed = true;
        (void)detail::failure_of([&] { result->error = failure->c_str(); });
      }
      (void)client.push(std::move(result));
    }
    void give_up(ShmPusher<Answer>& client, std::uint64_t number) {
      auto result = loan(client, number);
      result->has_given_up = true;
      (void)client.push(std::move(result));
    }
    ShmUniquePtr<Answer> loan(ShmPusher<Answer>& client, std::uint64_t number) {
      auto result = client.loan();
      result->number = number;
      result->has_given_up = false;
      result->has_failed = false;
      return result;
    }

    const std::shared_ptr<transport::Participant> participant;
    const detail::ServiceNames names;
    ShmQueue<ShmUniquePtr<Call>> calls;
    ShmPusher<Serving> presence;
    std::unordered_map<std::uint64_t, ShmPusher<Answer>> clients;  ///< that it has answered
  };

  std::unique_ptr<Core> core_;
  ShmListener listener_;  ///< goes first
};

}  // namespace lot
