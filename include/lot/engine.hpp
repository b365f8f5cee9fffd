// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "lot/any_message.hpp"
#include "lot/any_puller.hpp"
#include "lot/any_pusher.hpp"
#include "lot/any_queue.hpp"
#include "lot/any_type.hpp"
#include "lot/compliance.hpp"
#include "lot/detail/core.hpp"
#include "lot/detail/message_type.hpp"
#include "lot/message.hpp"
#include "lot/options.hpp"
#include "lot/puller.hpp"
#include "lot/pusher.hpp"
#include "lot/queue.hpp"
#include "lot/service.hpp"
#include "lot/wait_set.hpp"

namespace lot {

/// A process's place in a segment: makes publishers and subscribers.
///
///     lot::ShmEngine engine;                                   // segment LOTROS, made if absent
///     auto pusher = engine.advertise<Frame>("/camera/front");
///     auto puller = engine.subscribe<Frame>("/camera/front");
///
/// Several engines of a process on one segment share one participant. Pushers, pullers and pointers
/// may outlive their engine; the process leaves the segment when the last of them has gone, and the
/// last process removes it.
///
/// Threads: all members may be called at once, but for assignment and destruction. In a forked
///          child everything inherited is inert.
/// Errors:  lot::Error, which says what to do. Here, and in all that an engine makes: ECHILD in a
///          forked child, and ESTALE in a process that was stopped and that another process took
///          for dead meanwhile: make a new engine. std::bad_alloc when the process has no memory.
/// Memory:  the segment is mapped whole: address space of its size. The process has a place in it,
///          tables with an entry for each of its blocks, and the threads lot-warden, lot-witness,
///          lot-ahead once it publishes large messages, and lot-rouser once a push wakes two.
/// Crash:   the other processes see the death within milliseconds, free what the process had, and
///          its place. What it has pushed and put stays.
class ShmEngine {
 public:
  /// Joins the segment, and makes it where there is none. It waits for another process that joins
  /// or leaves just now, five seconds at most.
  ///
  /// Errors: EINVAL for options that cannot be (or variables of the environment), and where the
  /// file is no segment that may be replaced; EPERM for a segment of another user, or with other
  /// rights; EBUSY while it is in use with another size, or a stopped process opens or leaves it;
  /// ENOTEMPTY where another size would drop items that are to stay; EUSERS when as many processes
  /// are in it as it has room for; ENOSPC, EFBIG or ENOMEM when its directory, the file system or
  /// the address space has not the size; EAGAIN when there is no thread; what a system call said.
  explicit ShmEngine(const EngineOptions& options = EngineOptions());
  /// For programs of the library's own, which join in other ways. Throws lot::Error (ECHILD,
  /// ESTALE).
  explicit ShmEngine(std::shared_ptr<transport::Participant> participant);
  ~ShmEngine();
  ShmEngine(ShmEngine&&) noexcept = default;
  ShmEngine& operator=(ShmEngine&&) noexcept = default;

  /// A publisher of the topic, which makes its queue. It may wait for a process that advertises,
  /// subscribes or leaves, five seconds at most.
  /// Errors: EPROTOTYPE when the topic carries another type; EINVAL for a name of no or over 199
  /// bytes, for a depth that cannot be, for a bad LOT_QUEUE or LOT_STAMP; ENOSPC when the segment
  /// has no topic or channel left; EUSERS when the topic has more subscribers than
  /// EngineOptions::readers; EBUSY when a stopped process keeps the registry; EBADMSG when a
  /// process has written where it should not; lot::OutOfMemory when the segment has no room for the
  /// queue.
  template <class T>
  [[nodiscard]] ShmPusher<T> advertise(std::string_view topic,
                                       const PusherOptions& options = PusherOptions()) {
    assert_message<T>();
    return {detail::make_pusher(participant_, topic, detail::message_type<T>(), options,
                                detail::Delivery::ToAll),
            options.block_for};
  }
  /// Messages that are published after this call are received, or counted as missed, however late
  /// the puller looks, also when their publisher has left or was killed.
  /// Errors: EPROTOTYPE, EINVAL (the name), ENOSPC (topics), EBUSY and EBADMSG as advertise();
  /// EUSERS when a publisher has all the readers that it can have.
  template <class T>
  [[nodiscard]] ShmPuller<T> subscribe(std::string_view topic,
                                       const PullerOptions& options = PullerOptions()) {
    assert_message<T>();
    return ShmPuller<T>(detail::make_puller(participant_, topic, detail::message_type<T>(), options,
                                            detail::Delivery::ToAll));
  }
  /// What the topic carries; none where no process uses the topic. Errors: EBADMSG when a process
  /// has written where it should not; EBUSY as advertise().
  [[nodiscard]] AnyType type_of(std::string_view topic);
  /// As subscribe(), without a type: that of the topic. Where you only look on, say so:
  /// PullerOptions::observer.
  /// Errors: ENOENT when no process uses the topic: try again later; EINVAL when it is a queue,
  /// whose items are for those that take them; EBADMSG when a process has written where it should
  /// not; as subscribe().
  [[nodiscard]] AnyPuller subscribe_any(std::string_view topic,
                                        const PullerOptions& options = PullerOptions());
  /// The same, of a type that the program may not have: made while it runs, or that of another
  /// topic. No process need use the topic yet.
  /// Errors: EINVAL when it is no type, or that of a queue's items; as subscribe().
  [[nodiscard]] AnyPuller subscribe_any(std::string_view topic, const AnyType& type,
                                        const PullerOptions& options = PullerOptions());
  /// As advertise(), of a type that the program may not have: that of another topic, or of a
  /// message.
  /// Errors: EINVAL when it is no type, or that of a queue's items; as advertise().
  [[nodiscard]] AnyPusher advertise_any(std::string_view topic, const AnyType& type,
                                        const PusherOptions& options = PusherOptions());
  /// Subscribes, and calls callback(const ShmSharedPtr<const T>&) for each message on a thread of
  /// its own, until the listener is destroyed. A callback may take a const Envelope& as well.
  /// Errors: as subscribe(), and as the constructor of ShmListener.
  template <class T, class Callback>
  [[nodiscard]] ShmListener listen(std::string_view topic, Callback&& callback,
                                   const PullerOptions& options = PullerOptions(),
                                   const ThreadOptions& thread = ThreadOptions()) {
    return {subscribe<T>(topic, options), std::forward<Callback>(callback), options.wait, thread};
  }
  /// The same without a type: callback(const AnyMessage&), which may take a const Envelope& as
  /// well.
  /// Errors: as subscribe_any(), and as the constructor of ShmListener.
  template <class Callback>
  [[nodiscard]] ShmListener listen_any(std::string_view topic, Callback&& callback,
                                       const PullerOptions& options = PullerOptions(),
                                       const ThreadOptions& thread = ThreadOptions()) {
    return {subscribe_any(topic, options), std::forward<Callback>(callback), options.wait, thread};
  }
  /// One end, or both, of a queue of items of type T. What is needed to put is made by the first
  /// put, and what is needed to pop by the first pop: see there.
  ///
  /// Errors: EPROTOTYPE when other handles have another type, or differ in redeliver; EINVAL for a
  /// bad name or depth, for redeliver with Policy::Overwrite or with shared items; ENOSPC (topics),
  /// EBUSY and EBADMSG as advertise().
  template <class T>
  [[nodiscard]] ShmQueue<T> queue(std::string_view name,
                                  const QueueOptions& options = QueueOptions()) {
    using Item = detail::QueueItem<T>;
    using Element = typename Item::Element;
    assert_message<Element>();
    return ShmQueue<T>(detail::make_queue(participant_, name, detail::queue_type<T>(options),
                                          options, detail::delivery_of<T>(options)));
  }
  /// As queue() of values, or of ShmUniquePtrs, of a type that the program may not have.
  /// Errors: EINVAL when it is no type, or that of a queue's items; as queue().
  [[nodiscard]] AnyQueue queue_any(std::string_view name, const AnyType& type,
                                   const QueueOptions& options = QueueOptions());
  /// Answers the requests of a service by handler(const Request&, Response&), on a thread of its
  /// own, until the server is destroyed. The response is built in shared memory: what the handler
  /// makes of it, the client reads there.
  /// Errors: EPROTOTYPE when the service has other types; EINVAL for a name of no or over 170
  /// bytes; as queue(), advertise(), and the constructor of ShmListener.
  template <class Request, class Response, class Handler>
  [[nodiscard]] ShmServer<Request, Response> serve(std::string_view name, Handler&& handler,
                                                   const ServerOptions& options = ServerOptions()) {
    static_assert(std::is_invocable_v<std::decay_t<Handler>&, const Request&, Response&>,
                  "lot: this handler does not take a request and a response: "
                  "(const Request&, Response&)");
    assert_message<Request>();
    assert_message<Response>();
    return {participant_, name, std::forward<Handler>(handler), options};
  }
  /// Asks the servers of a service, which may come later.
  /// Errors: EPROTOTYPE when the service has other types; EINVAL for a name of no or over 170
  /// bytes; as queue() and subscribe(); lot::OutOfMemory.
  template <class Request, class Response>
  [[nodiscard]] ShmClient<Request, Response> client(
      std::string_view name, const ClientOptions& options = ClientOptions()) {
    assert_message<Request>();
    assert_message<Response>();
    return {participant_, name, options};
  }
  /// A message that belongs to no topic: to be pushed on several, or referred to by others.
  /// Errors: lot::OutOfMemory; what the constructor of T throws.
  template <class T, class... Args>
  [[nodiscard]] ShmUniquePtr<T> make(Args&&... args) {
    assert_message<T>();
    return detail::build<T>(maker_->loan(detail::message_type<T>(), true),
                            std::forward<Args>(args)...);
  }

  /// The same of a type that the program may not have: to be built, and then shared. See
  /// AnyPusher::loan(). Throws the same.
  [[nodiscard]] AnyLoan make_any(const AnyType& type);

  /// The file that the segment is. The reference is valid as long as the engine, or anything that
  /// it has made.
  const std::string& path() const noexcept;

 private:
  /// The same type as this participant has it. Throws lot::Error.
  AnyType shared(const AnyType& type, std::string_view topic);

  std::shared_ptr<transport::Participant> participant_;
  std::unique_ptr<detail::PusherCore> maker_;
};

}  // namespace lot
