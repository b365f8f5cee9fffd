// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <exception>
#include <fcntl.h>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <utility>
#include <vector>

#include <fastdds/dds/core/LoanableSequence.hpp>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/log/Log.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>

#include "transport.hpp"
#include "warm.hpp"

/// Fast DDS 2.9.1 over shared memory, in two ways: its shared-memory transport, which copies; and
/// data-sharing with loans, which does not. No message goes through a socket, nor does discovery.
///
/// What is named: files of data-sharing lie in Stream::directory. The transport's are
/// /dev/shm/fastrtps_<number> and their semaphores: the harness removes those from its own time
/// that no living process has locked, as `fastdds shm clean` does, of ports only its domain's.
///
/// Crash:  a killed harness leaves files; `fastdds shm clean` removes them. A killed subscriber
///         stops a lossless publisher until its lease ends, for 20 s.
namespace ab {
namespace {

using namespace std::chrono_literals;
namespace dds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
namespace fs = std::filesystem;
using eprosima::fastrtps::types::ReturnCode_t;

enum class Way { Copy, Share };

constexpr const char* kShm = "/dev/shm/";
constexpr const char* kPrefix = "/dev/shm/fastrtps_";
/// Larger messages travel in parts. Smaller parts cost more each, larger ones leave the caches.
constexpr std::uint32_t kFragment = 1 << 20;
constexpr std::size_t kLargest = 256 << 20;
constexpr std::int32_t kSpare = 4;  // samples, beside those in the history
constexpr int kBlockFor = 30;       // seconds

// ---- the message --------------------------------------------------------------------------------

struct Bytes {
  std::byte first;  // of Stream::size
};

/// So many bytes and nothing else: bounded and plain, which is what loans ask for.
class MessageType final : public dds::TopicDataType {
 public:
  explicit MessageType(std::size_t size) : size_(static_cast<std::uint32_t>(size)) {
    setName("lot_ab_message");
    m_typeSize = size_ + kHeader;
    auto_fill_type_object(false);
    auto_fill_type_information(false);
  }
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    if (payload->max_size < m_typeSize) return false;
    payload->encapsulation = CDR_LE;
    const std::uint8_t header[kHeader] = {0, CDR_LE, 0, 0};
    std::memcpy(payload->data, header, kHeader);
    std::memcpy(payload->data + kHeader, data, size_);
    payload->length = m_typeSize;
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t* payload, void* data) override {
    if (payload->length < m_typeSize) return false;
    std::memcpy(data, payload->data + kHeader, size_);
    return true;
  }
  std::function<std::uint32_t()> getSerializedSizeProvider(void*) override {
    return [bytes = m_typeSize] { return bytes; };
  }
  void* createData() override { return operator new(size_); }
  void deleteData(void* data) override { operator delete(data); }
  bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
  bool is_bounded() const override { return true; }
  bool is_plain() const override { return true; }
  bool construct_sample(void*) const override { return true; }

 private:
  static constexpr std::uint32_t kHeader = 4;  // says how it is encoded
  std::uint32_t size_;
};

// ---- a node's part ------------------------------------------------------------------------------

std::uint32_t domain_of(const Stream& stream) {
  std::uint32_t hash = 2166136261;
  for (const char c : stream.name) hash = (hash ^ static_cast<unsigned char>(c)) * 16777619;
  return hash % 201;
}

constexpr std::uint32_t kFirstPort = 7400;  // as RTPS numbers them
constexpr std::uint32_t kPortsOfDomain = 250;
constexpr std::uint32_t kSmallSegment = 4 << 20;  // of who has no messages to send in it

/// Of each publisher. A packet that finds no room is sent again much later, so this is generous.
std::uint32_t segment_bytes(const Stream& stream, Way way) {
  constexpr std::uint64_t kMessages = 24;
  constexpr std::uint64_t kMost = 1 << 30;
  if (way == Way::Share) return kSmallSegment;
  return static_cast<std::uint32_t>(
      std::min(kMost, kSmallSegment + kMessages * (stream.size + (64 << 10))));
}

/// Of what waits for a subscriber that is slow, over all publishers.
std::int32_t depth_of(const Stream& stream, unsigned publishers) {
  return static_cast<std::int32_t>(std::max(1U, stream.depth) * publishers);
}

void check(ReturnCode_t code, const char* what) {
  if (code != ReturnCode_t::RETCODE_OK)
    throw std::runtime_error(std::string("fastdds: ") + what + " said " + std::to_string(code()));
}
template <class T>
T* made(T* thing, const char* what) {
  if (thing == nullptr) throw std::runtime_error(std::string("fastdds: no ") + what);
  return thing;
}

/// A participant and its topic.
class Node {
 public:
  Node(const Stream& stream, std::uint32_t segment) {
    dds::Log::SetVerbosity(dds::Log::Kind::Error);
    dds::DomainParticipantQos qos;
    qos.name(stream.name);
    const auto transport =
        std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>();
    transport->segment_size(segment);
    transport->max_message_size(kFragment);
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(transport);
    auto& discovery = qos.wire_protocol().builtin.discovery_config;
    discovery.initial_announcements.count = 50;
    discovery.initial_announcements.period = {0, 100'000'000};
    participant_ = made(
        dds::DomainParticipantFactory::get_instance()->create_participant(domain_of(stream), qos),
        "participant");
    const dds::TypeSupport type(new MessageType(stream.size));
    check(type.register_type(participant_), "register_type");
    topic_ =
        made(participant_->create_topic(stream.name, type.get_type_name(), dds::TOPIC_QOS_DEFAULT),
             "topic");
  }
  ~Node() {
    participant_->delete_contained_entities();
    dds::DomainParticipantFactory::get_instance()->delete_participant(participant_);
  }
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  dds::DomainParticipant& participant() { return *participant_; }
  dds::Topic* topic() { return topic_; }

 private:
  dds::DomainParticipant* participant_;
  dds::Topic* topic_ = nullptr;
};

template <class Qos>
void set_common(Qos& qos, const Stream& stream, Way way, unsigned publishers) {
  const std::int32_t depth = depth_of(stream, publishers);
  qos.durability().kind = dds::VOLATILE_DURABILITY_QOS;
  // Best effort loses whatever meets a full queue of the transport; this repeats it.
  qos.reliability().kind = dds::RELIABLE_RELIABILITY_QOS;
  qos.reliability().max_blocking_time = {kBlockFor, 0};
  qos.history().kind = stream.lossless ? dds::KEEP_ALL_HISTORY_QOS : dds::KEEP_LAST_HISTORY_QOS;
  qos.history().depth = depth;
  qos.resource_limits().max_instances = 1;
  qos.resource_limits().max_samples = depth;
  qos.resource_limits().max_samples_per_instance = depth;
  qos.resource_limits().allocated_samples = depth;
  qos.resource_limits().extra_samples = kSpare;
  qos.endpoint().history_memory_policy = rtps::PREALLOCATED_MEMORY_MODE;
  if (way == Way::Share) {
    qos.data_sharing().on(stream.directory);
  } else {
    qos.data_sharing().off();
  }
}

/// Removes what killed nodes have left in /dev/shm. When it ends no node lives.
class Cleaner final : public Service {
 public:
  explicit Cleaner(const Stream& stream) : domain_(domain_of(stream)) {
    clock_gettime(CLOCK_REALTIME_COARSE, &since_);
  }
  ~Cleaner() override {
    const std::vector<std::string> candidates = abandoned();
    if (candidates.empty()) return;
    // Others make a file and lock it then.
    std::this_thread::sleep_for(100ms);
    const std::vector<std::string> still = abandoned();
    for (const std::string& path : candidates) {
      if (std::find(still.begin(), still.end(), path) != still.end()) remove(path);
    }
  }

 private:
  /// Files, without those beside them, which are of our time and which nobody has locked.
  std::vector<std::string> abandoned() const {
    std::vector<std::string> paths;
    std::error_code ignored;
    for (const auto& entry : fs::directory_iterator(kShm, ignored)) {
      std::string path = entry.path();
      if (path.rfind(kPrefix, 0) != 0 || !is_of_our_time(path)) continue;
      for (const char* lock : {"_el", "_sl"}) {
        if (path.ends_with(lock)) path.resize(path.size() - std::strlen(lock));
      }
      if (is_port_of_another_domain(path)) continue;
      const bool is_new = std::find(paths.begin(), paths.end(), path) == paths.end();
      if (is_new && !is_locked(path + "_el") && !is_locked(path + "_sl")) paths.push_back(path);
    }
    return paths;
  }
  /// Those may be written to before anybody listens there and locks them.
  bool is_port_of_another_domain(const std::string& path) const {
    const std::string name = path.substr(std::strlen(kPrefix));
    unsigned port = 0;
    if (std::sscanf(name.c_str(), "port%u", &port) != 1) return false;
    return port < kFirstPort || (port - kFirstPort) / kPortsOfDomain != domain_;
  }
  bool is_of_our_time(const std::string& path) const {
    struct stat about {};
    if (lstat(path.c_str(), &about) != 0 || about.st_uid != geteuid()) return false;
    const timespec& t = about.st_ctim;
    return t.tv_sec > since_.tv_sec || (t.tv_sec == since_.tv_sec && t.tv_nsec >= since_.tv_nsec);
  }
  static bool is_locked(const std::string& path) {
    const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) return false;
    const bool locked = flock(fd, LOCK_EX | LOCK_NB) != 0;
    close(fd);
    return locked;
  }
  static void remove(const std::string& path) {
    std::error_code ignored;
    const std::string semaphore =
        std::string(kShm) + "sem." + fs::path(path).filename().string() + "_mutex";
    for (const std::string& file : {path, path + "_el", path + "_sl", semaphore})
      fs::remove(file, ignored);
  }

  std::uint32_t domain_;
  timespec since_{};
};

std::string refuses(const Stream& stream, Way way) {
  if (stream.isolated)
    return "its nodes find each other in /dev/shm, which containers do not share; set --place host";
  if (stream.size > kLargest)
    return "its messages are at most " + std::to_string(kLargest >> 20) +
           " MiB; set a smaller size";
  std::uint64_t need = stream.publishers * std::uint64_t{segment_bytes(stream, way)} +
                       stream.subscribers * std::uint64_t{kSmallSegment};
  if (way == Way::Share)
    need += std::uint64_t{stream.publishers} * (stream.depth + kSpare) * (stream.size + 4096);
  struct statvfs disk {};
  if (statvfs(kShm, &disk) == 0 && std::uint64_t{disk.f_bavail} * disk.f_frsize < need)
    return "needs " + std::to_string(need >> 20) + " MiB in /dev/shm; set a smaller size or depth";
  return "";
}

/// Files by which subscribers say that they have met a writer: it meets them before, and what it
/// sends in between is lost.
std::string met_prefix(const std::string& directory, const rtps::GUID_t& writer) {
  std::ostringstream text;
  text << directory << "/met-" << writer << '-';
  return text.str();
}

class FastddsSender final : public Sender {
 public:
  FastddsSender(const Stream& stream, Way way)
      : size_(stream.size),
        copies_(way == Way::Copy),
        lossless_(stream.lossless),
        directory_(stream.directory),
        node_(stream, segment_bytes(stream, way)) {
    dds::Publisher* const publishing =
        made(node_.participant().create_publisher(dds::PUBLISHER_QOS_DEFAULT), "publisher");
    dds::DataWriterQos qos;
    set_common(qos, stream, way, 1);
    qos.publish_mode().kind = dds::SYNCHRONOUS_PUBLISH_MODE;
    // Acknowledgements answer these; a history that nobody acknowledges is full.
    qos.reliable_writer_qos().times.heartbeatPeriod = {0, 1'000'000};
    qos.reliable_writer_qos().times.nackResponseDelay = {0, 0};
    writer_ = made(publishing->create_datawriter(node_.topic(), qos), "data writer");
    touch_all_loans(depth_of(stream, 1) + kSpare);
    warm(kPrefix);
    warm(stream.directory + "/");
  }

  ~FastddsSender() override {
    if (loaned_ != nullptr) writer_->discard_loan(loaned_);
  }

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    const auto until = std::chrono::steady_clock::now() + patience;
    for (;;) {
      dds::PublicationMatchedStatus status;
      check(writer_->get_publication_matched_status(status), "get_publication_matched_status");
      if (status.current_count >= static_cast<std::int32_t>(subscribers) &&
          have_met_us() >= subscribers)
        break;
      if (std::chrono::steady_clock::now() >= until) return false;
      std::this_thread::sleep_for(1ms);
    }
    return true;
  }
  std::byte* loan() override {
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(kBlockFor);
    while (loaned_ == nullptr) {
      const ReturnCode_t code = writer_->loan_sample(loaned_);
      if (code == ReturnCode_t::RETCODE_OK) break;
      if (code != ReturnCode_t::RETCODE_OUT_OF_RESOURCES ||
          std::chrono::steady_clock::now() >= until)
        check(code, "loan_sample");
      std::this_thread::sleep_for(20us);
    }
    return static_cast<std::byte*>(loaned_);
  }
  bool push() override {
    // A full history is let go of one by one, and write() may find it full again.
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(kBlockFor);
    while (!writer_->write(loaned_)) {  // which keeps the loan
      if (!lossless_ || std::chrono::steady_clock::now() >= until) return false;
    }
    loaned_ = nullptr;
    if (copies_) copied_ += 2 * size_;  // into packets, and those into the transport's segment
    return true;
  }
  std::uint64_t copied() const override { return copied_; }

 private:
  std::size_t have_met_us() const {
    const std::string prefix = met_prefix(directory_, writer_->guid());
    const fs::directory_iterator files(directory_);
    return static_cast<std::size_t>(
        std::count_if(begin(files), end(files), [&](const fs::directory_entry& entry) {
          return entry.path().string().rfind(prefix, 0) == 0;
        }));
  }

  void touch_all_loans(std::int32_t most) {
    std::vector<void*> loans;
    for (void* loan = nullptr; static_cast<std::int32_t>(loans.size()) < most &&
                               writer_->loan_sample(loan) == ReturnCode_t::RETCODE_OK;)
      std::memset(loans.emplace_back(loan), 0, size_);
    for (void* loan : loans) check(writer_->discard_loan(loan), "discard_loan");
  }

  std::size_t size_;
  bool copies_;
  bool lossless_;
  std::string directory_;
  Node node_;
  dds::DataWriter* writer_ = nullptr;
  void* loaned_ = nullptr;
  std::uint64_t copied_ = 0;
};

/// While receive() waits, the library's thread that brings a message calls the handler: a second
/// wake-up is spared. So it is for every ab::Wait: who spins until that thread has come keeps a
/// core and a lock from it, which was measured to be slower in the median, tails and throughput.
class FastddsReceiver final : public Receiver, private dds::DataReaderListener {
 public:
  FastddsReceiver(const Stream& stream, Way way, unsigned subscriber)
      : size_(stream.size),
        copies_(way == Way::Copy),
        directory_(stream.directory),
        subscriber_(subscriber),
        node_(stream, kSmallSegment) {
    dds::Subscriber* const subscribing =
        made(node_.participant().create_subscriber(dds::SUBSCRIBER_QOS_DEFAULT), "subscriber");
    dds::DataReaderQos qos;
    set_common(qos, stream, way, stream.publishers);
    qos.reliable_reader_qos().times.heartbeatResponseDelay = {0, 0};
    const dds::StatusMask mask = dds::StatusMask::subscription_matched()
                                 << dds::StatusMask::data_available();
    reader_ = made(subscribing->create_datareader(node_.topic(), qos, this, mask), "data reader");
  }
  ~FastddsReceiver() override { reader_->set_listener(nullptr); }

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    const auto until = patience < 0ns ? std::chrono::steady_clock::time_point::max()
                                      : std::chrono::steady_clock::now() + patience;
    for (;;) {
      if (take(handler)) return true;
      if (std::chrono::steady_clock::now() >= until) return false;
      const Outcome outcome = leave_it_to_the_listener(handler, until);
      if (outcome == Outcome::TimedOut) return false;
      if (outcome == Outcome::Taken) return true;
    }
  }
  std::uint64_t missed() const override { return missed_; }
  std::uint64_t copied() const override { return copied_; }

 private:
  enum class Outcome { Taken, NothingThere, TimedOut };

  Outcome leave_it_to_the_listener(const Handler& handler,
                                   std::chrono::steady_clock::time_point until) {
    outcome_.reset();
    waiting_.store(&handler, std::memory_order_seq_cst);
    // What came between the last look and this will not be announced again.
    if (reader_->get_unread_count() > 0 &&
        waiting_.exchange(nullptr, std::memory_order_seq_cst) != nullptr)
      return Outcome::NothingThere;
    std::unique_lock lock(mutex_);
    const auto is_done = [this] { return outcome_.has_value(); };
    if (until == std::chrono::steady_clock::time_point::max()) {
      done_.wait(lock, is_done);
    } else if (!done_.wait_until(lock, until, is_done)) {
      if (waiting_.exchange(nullptr, std::memory_order_seq_cst) != nullptr)
        return Outcome::TimedOut;
      done_.wait(lock, is_done);  // it is at it
    }
    if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
    return *outcome_;
  }

  void on_data_available(dds::DataReader*) override {
    const Handler* const handler = waiting_.exchange(nullptr, std::memory_order_seq_cst);
    if (handler == nullptr) return;
    Outcome outcome = Outcome::Taken;
    std::exception_ptr error;
    try {
      if (!take(*handler)) outcome = Outcome::NothingThere;
    } catch (...) {
      error = std::current_exception();
    }
    const std::lock_guard lock(mutex_);
    outcome_ = outcome;
    error_ = error;
    done_.notify_one();
  }

  void on_subscription_matched(dds::DataReader*,
                               const dds::SubscriptionMatchedStatus& status) override {
    warm(kPrefix);
    warm(directory_ + "/");
    rtps::GUID_t writer;
    rtps::iHandle2GUID(writer, status.last_publication_handle);
    std::ofstream(met_prefix(directory_, writer) + std::to_string(subscriber_));
  }

  /// By the caller of receive(), or by the listener while that one waits.
  bool take(const Handler& handler) {
    dds::LoanableSequence<Bytes> messages;
    dds::SampleInfoSeq infos;
    if (reader_->take(messages, infos, 1) != ReturnCode_t::RETCODE_OK) return false;
    const bool is_message = infos[0].valid_data && is_next(infos[0]) &&
                            reader_->is_sample_valid(&messages[0], &infos[0]);
    if (is_message) {
      if (copies_) copied_ += size_;
      try {
        handler({&messages[0].first, size_});
      } catch (...) {
        reader_->return_loan(messages, infos);
        throw;
      }
    }
    reader_->return_loan(messages, infos);
    return is_message;
  }

  /// A writer numbers its samples: what is left out was lost.
  bool is_next(const dds::SampleInfo& info) {
    const auto& identity = info.sample_identity;
    const std::uint64_t number = identity.sequence_number().to64long();
    std::uint64_t& next = next_.try_emplace(identity.writer_guid(), number).first->second;
    if (number < next) return false;
    missed_ += number - next;
    next = number + 1;
    return true;
  }

  std::size_t size_;
  bool copies_;
  std::string directory_;
  unsigned subscriber_;
  std::map<rtps::GUID_t, std::uint64_t> next_;
  std::uint64_t missed_ = 0;
  std::uint64_t copied_ = 0;

  std::atomic<const Handler*> waiting_{nullptr};  // who takes it away calls it
  std::mutex mutex_;
  std::condition_variable done_;
  std::optional<Outcome> outcome_;
  std::exception_ptr error_;

  Node node_;
  dds::DataReader* reader_ = nullptr;
};

Transport fastdds_transport(std::string name, std::string about, Way way) {
  Transport t;
  t.name = std::move(name);
  t.about = std::move(about);
  t.copies = way == Way::Copy;
  t.refuses = [way](const Stream& stream) { return refuses(stream, way); };
  t.serve = [](const Stream& stream) { return std::make_unique<Cleaner>(stream); };
  t.sender = [way](const Stream& stream, unsigned) {
    return std::make_unique<FastddsSender>(stream, way);
  };
  t.receiver = [way](const Stream& stream, unsigned subscriber) {
    return std::make_unique<FastddsReceiver>(stream, way, subscriber);
  };
  return t;
}

}  // namespace

std::vector<Transport> fastdds_transports() {
  return {fastdds_transport("fastdds", "Fast DDS 2.9.1: its shared-memory transport", Way::Copy),
          fastdds_transport("fastdds-loan", "Fast DDS 2.9.1: data-sharing with loans", Way::Share)};
}

}  // namespace ab
