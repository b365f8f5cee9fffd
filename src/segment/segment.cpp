// SPDX-License-Identifier: Apache-2.0
#include "segment/segment.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <sys/mman.h>
#include <sys/random.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <boost/interprocess/exceptions.hpp>

#include "lot/error.hpp"
#include "lot/options.hpp"

#include "futex/futex.hpp"
#include "segment/descriptors.hpp"
#include "segment/system_limits.hpp"

namespace lot::segment {
namespace {

constexpr std::uint64_t kDefaultSize = std::uint64_t{1} << 30;
constexpr std::uint64_t kSmallestData = std::uint64_t{4} << 20;
/// A run of at least this many granules is mapped by whole units: the page faults would take
/// longer.
constexpr std::uint32_t kMappedAtOnce = 128;

constexpr std::uint64_t round_up(std::uint64_t n, std::uint64_t to) {
  return (n + to - 1) / to * to;
}

std::uint32_t units_of(const Capacity& c) {
  return static_cast<std::uint32_t>((c.size + kUnit - 1) / kUnit);
}

std::uint64_t hash(const char* bytes, std::size_t n, std::uint64_t h = 14695981039346656037U) {
  for (std::size_t i = 0; i < n; ++i) {
    h = (h ^ static_cast<unsigned char>(bytes[i])) * 1099511628211U;  // FNV-1a
  }
  return h;
}

/// A hash of what two builds must have in common to read each other's bytes.
std::uint64_t fingerprint() {
  const std::uint64_t facts[] = {sizeof(void*),    std::endian::native == std::endian::little,
                                 Atomics::kLine,   Atomics::kOwnWords,
                                 ring::kBlockBits, ring::kSequenceShift,
                                 sizeof(Capacity), kGranule,
                                 kSmallBytes};
  return hash(reinterpret_cast<const char*>(facts), sizeof(facts));
}

std::uint64_t boot() {
  std::ifstream file("/proc/sys/kernel/random/boot_id");
  std::string id;
  return file >> id ? hash(id.data(), id.size()) : 0;
}

struct Descriptor {  // also the memory-mappable object for Boost's mapped_region
  int fd;
  boost::interprocess::mode_t mode;
  explicit Descriptor(int f, boost::interprocess::mode_t m = boost::interprocess::read_write)
      : fd(f), mode(m) {}
  ~Descriptor() {
    if (fd != -1) ::close(fd);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  boost::interprocess::mapping_handle_t get_mapping_handle() const { return {fd, false}; }
  boost::interprocess::mode_t get_mode() const { return mode; }
};

/// Maps the whole file at a multiple of a unit: huge pages must lie like that, where the file
/// system has them.
boost::interprocess::mapped_region map_file(const Descriptor& file, std::uint64_t size) {
  // The kernel first reserves a room of addresses. Then the file is mapped inside it, so that no
  // other thread can take those addresses in between.
  const std::uint64_t room_size = size + kUnit;
  void* const room =
      mmap(nullptr, room_size, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (room == MAP_FAILED) throw boost::interprocess::interprocess_exception(errno);
  const auto begin = reinterpret_cast<std::uintptr_t>(room);
  const std::uint64_t before = round_up(begin, kUnit) - begin;
  auto* const place = static_cast<unsigned char*>(room) + before;
  try {
    boost::interprocess::mapped_region region(file, file.mode, 0, size, place, MAP_FIXED);
    if (before != 0) munmap(room, before);
    munmap(place + size, kUnit - before);
    // EINVAL: a kernel without huge pages.
    madvise(place, size, MADV_HUGEPAGE);
    return region;
  } catch (...) {
    munmap(room, room_size);
    throw;
  }
}

/// The lock of a ring of the mutex engine. REQUIRES: the ring's place was checked.
mutex_engine::Lock& lock_of(const Ring& ring) {
  auto* word = reinterpret_cast<unsigned char*>(ring.arrived);
  return *reinterpret_cast<mutex_engine::Lock*>(word - offsetof(mutex_engine::Lock, arrived));
}

/// True when the kernel does not know the call (Linux before 5.14 has no MADV_POPULATE_WRITE), or
/// when a sandbox refuses it.
bool is_refused(int error) {
  return error == EINVAL || error == EPERM || error == EACCES || error == ENOSYS;
}

/// Makes the file system give the memory of the first bytes of a file that no other process knows
/// yet. Returns 0 or an error.
int reserve_new(int fd, std::uint64_t bytes) {
  int error;
  do {
    error = posix_fallocate(fd, 0, static_cast<off_t>(bytes));
  } while (error == EINTR);
  if (!is_refused(error)) return error;
  const std::vector<char> zeros(kUnit);
  for (std::uint64_t done = 0; done < bytes;) {
    const ssize_t n = pwrite(fd, zeros.data(), std::min<std::uint64_t>(zeros.size(), bytes - done),
                             static_cast<off_t>(done));
    if (n == -1 && errno == EINTR) continue;
    if (n <= 0) return n == 0 ? ENOSPC : errno;
    done += static_cast<std::uint64_t>(n);
  }
  return 0;
}

Capacity choose_size(const std::string& path, Capacity capacity) {
  const std::string directory = path.substr(0, path.rfind('/'));
  struct statvfs room {};
  if (statvfs(directory.c_str(), &room) == -1) {
    throw Error(errno, directory, "cannot look at the segment directory",
                "make it, or name another with LOT_DIR");
  }
  const std::uint64_t free = std::uint64_t{room.f_bavail} * room.f_frsize;
  const bool chosen = capacity.size != 0;
  const std::uint64_t asked = capacity.size;
  const std::uint64_t of_a_file = file_limit();
  // Half of the group's limit: the processes need memory of their own.
  const std::uint64_t of_the_group = memory_limit() / 2;
  if (!chosen) capacity.size = std::min({kDefaultSize, free / 4 * 3, of_a_file, of_the_group});
  capacity.size = capacity.size / kUnit * kUnit;
  const std::uint64_t least = Geometry::of(capacity).data + kSmallestData;
  if (capacity.size < least) {
    std::string limit = size_text(asked) + " were asked for";
    const char* remedy = "raise LOT_SIZE";
    if (!chosen && of_a_file <= capacity.size + kUnit) {
      limit = "a file of this process may have " + size_text(of_a_file);
      remedy = "raise RLIMIT_FSIZE (ulimit -f)";
    } else if (!chosen && of_the_group <= capacity.size + kUnit) {
      limit = "the processes of this control group may have " + size_text(of_the_group * 2) +
              " of memory, and it takes at most half of that";
      remedy = "raise the group's memory limit, or set LOT_SIZE";
    } else if (!chosen) {
      limit = size_text(free) + " are free in " + directory +
              ", and it takes at most three quarters of that";
      remedy =
          "free memory there, enlarge it (docker run --shm-size), set LOT_DIR, or set LOT_SIZE";
    }
    throw Error(chosen ? EINVAL : ENOSPC, path,
                "a segment needs at least " + size_text(least + kUnit) + "; " + limit, remedy);
  }
  if (capacity.size > free) {
    throw Error(ENOSPC, path,
                size_text(capacity.size) + " were asked for, " + size_text(free) + " are free in " +
                    directory,
                "lower LOT_SIZE, enlarge the file system (docker run --shm-size), or set LOT_DIR");
  }
  if (capacity.size > of_a_file) {  // else a signal (SIGXFSZ) would end the process
    throw Error(EFBIG, path,
                size_text(capacity.size) + " were asked for, a file of this process may have " +
                    size_text(of_a_file),
                "lower LOT_SIZE, or raise RLIMIT_FSIZE (ulimit -f)");
  }
  if (capacity.size / 2 > of_the_group) {
    std::fprintf(stderr,
                 "lot: %s: warning: it has %s, and the processes of this control group may have %s "
                 "of memory together; lower LOT_SIZE, or raise the group's memory limit\n",
                 path.c_str(), size_text(capacity.size).c_str(),
                 size_text(of_the_group * 2).c_str());
  }
  return capacity;
}

/// The reason why these bytes are no segment for us, or "".
std::string objection(const Header& h, std::uint64_t file_size) {
  if (file_size < sizeof(Header))
    return "it is too short (" + std::to_string(file_size) + " bytes)";
  if (std::memcmp(h.identity.magic, kMagic, sizeof(kMagic)) != 0) return "it is not a LOT segment";
  if (h.identity.layout_version != kLayoutVersion) {
    return "it has layout version " + std::to_string(h.identity.layout_version) +
           ", this library has " + std::to_string(kLayoutVersion);
  }
  if (h.identity.fingerprint != fingerprint() || h.identity.header_bytes != sizeof(Header)) {
    return "it was made by a build with other word sizes";
  }
  const Capacity& c = h.capacity;
  if (h.identity.size != file_size || c.size != file_size) {
    return "its file is " + std::to_string(file_size) + " bytes, its header says " +
           std::to_string(h.identity.size);
  }
  if (c.participants < 2 || c.participants > kMaxParticipants || c.blocks == 0 ||
      c.blocks >= ring::kNoBlock || c.topics == 0 || c.topics > (1U << 20) || c.channels == 0 ||
      c.channels > (1U << 20) || c.readers == 0 || c.readers > (1U << 16) ||
      Geometry::of(c).data + kGranule > c.size || h.check != check_of(c)) {
    return "its header is damaged";
  }
  return "";
}

Header read_header(int fd, std::uint64_t& size) {
  struct stat status {};
  Header header{};
  fstat(fd, &status);
  size = static_cast<std::uint64_t>(status.st_size);
  if (size >= sizeof(header) && pread(fd, &header, sizeof(header), 0) != sizeof(header)) size = 0;
  return header;
}

/// Why a segment of `size` bytes is not one of `wanted`; "" where it is. 0: any will do.
std::string size_objection(std::uint64_t size, std::uint64_t wanted) {
  if (wanted == 0 || wanted / kUnit * kUnit == size) return "";
  return "it has " + size_text(size) + ", " + size_text(wanted) + " were asked for";
}

Segment::Fit fit_of(int fd, std::uint64_t wanted, std::string& reason) {
  std::uint64_t file_size = 0;
  const Header header = read_header(fd, file_size);
  reason = objection(header, file_size);
  if (!reason.empty()) {
    return std::memcmp(header.identity.magic, kMagic, sizeof(kMagic)) == 0 ? Segment::Fit::Stale
                                                                           : Segment::Fit::Foreign;
  }
  const std::uint64_t here = header.identity.boot != 0 ? boot() : 0;
  if (here != 0 && header.identity.boot != here) {
    reason = "it was left by another boot of the system";
  } else {
    reason = size_objection(file_size, wanted);
  }
  return reason.empty() ? Segment::Fit::Fits : Segment::Fit::Stale;
}

[[noreturn]] void refuse(const std::string& path, const char* what, int error) {
  if (const std::string kind = kind_of(path); !kind.empty()) {
    throw Error(error, path, std::string(what) + ": it is " + kind + ", no file of LOT",
                "remove it if it is yours, or set LOT_SEGMENT or LOT_DIR");
  }
  const std::string owner = error == EACCES ? owner_and_mode(path) : "";
  if (!owner.empty()) {
    throw Error(error, path, std::string(what) + ", it belongs to " + owner, way_in(path));
  }
  const bool is_there = !owner_and_mode(path).empty();
  const char* advice = error == EROFS && is_there
                           ? "its directory is mounted read-only, and each process that joins "
                             "writes: mount it so that you may write"
                       : error == EROFS  ? "the directory is read-only: name another with LOT_DIR"
                       : error == ENOENT ? "make the directory, or name another with LOT_DIR"
                       : error == ENOSPC ? "free memory there, or name another with LOT_DIR"
                       : error == EAGAIN
                           ? "end the process that has a lease on it, or set LOT_SEGMENT"
                       : error == EMFILE ? "raise the limit of open files (ulimit -n)"
                       : error == ENFILE ? "the system has no more open files (fs.file-max)"
                       : error == EEXIST ? "its owner, or root, can remove it; or name another "
                                           "directory with LOT_DIR"
                                         : "set LOT_DIR to a directory that you may write to";
  const std::string rival = error == EEXIST || error == EAGAIN ? owner_and_mode(path) : "";
  throw Error(error, path, what + (rival.empty() ? "" : ": what is there belongs to " + rival),
              advice);
}

/// Gives a new file its group and mode, whatever the umask. Closes it when it cannot have them.
void give_rights(int fd, const std::string& path, const Trust& trust) {
  const auto fail = [&](const char* what, const char* advice) {
    const int error = errno;
    ::close(fd);
    throw Error(error, path, what, advice);
  };
  if (trust.group && fchown(fd, static_cast<uid_t>(-1), *trust.group) == -1) {
    fail("a new file cannot be given to that group",
         "name one that you are a member of (LOT_GROUP)");
  }
  if (fchmod(fd, trust.mode) == -1) {
    fail("a new file cannot have those permissions", "set LOT_PERMISSIONS or LOT_DIR");
  }
}

/// Makes a new file, which gets its name only after its mode, whatever the umask. -1 and errno when
/// it cannot be made; EEXIST: there is one.
///
/// Crash: leaves no file, or a whole one. There is one exception, where the file system has no
/// unnamed files, or there is no /proc. Then a maker that is killed in between leaves a file of
/// mode 0600, or less by its umask.
int make_private(const std::string& path, const Trust& trust) {
  const std::string directory = path.substr(0, path.rfind('/') + 1);
  const int unnamed = open_file(directory, O_TMPFILE | O_RDWR, 0600);
  if (unnamed != -1) {
    give_rights(unnamed, path, trust);
    if (linkat(AT_FDCWD, ("/proc/self/fd/" + std::to_string(unnamed)).c_str(), AT_FDCWD,
               path.c_str(), AT_SYMLINK_FOLLOW) == 0) {
      return unnamed;
    }
    ::close(unnamed);
  }
  // There is a file of that name already, or the file cannot be made in this way.
  const int fd = open_file(path, O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW, 0600);
  if (fd == -1) return -1;
  try {
    give_rights(fd, path, trust);
  } catch (...) {
    ::unlink(path.c_str());
    throw;
  }
  return fd;
}

void require_or_close(const Trust& trust, int fd, const std::string& path) {
  try {
    trust.require(fd, path);
  } catch (...) {
    ::close(fd);
    throw;
  }
}

}  // namespace

int open_private(const std::string& path, const Trust& trust, int flags) {
  for (;;) {
    if ((flags & O_EXCL) == 0) {
      // Without O_CREAT: in a sticky directory fs.protected_regular refuses it for another user's
      // file, even if the file's mode lets us in. A file that is there keeps its mode and owner.
      const int fd = open_file(path, O_RDWR | O_NOFOLLOW | O_NONBLOCK);
      if (fd != -1) {
        require_or_close(trust, fd, path);
        return fd;
      }
      if (errno != ENOENT) refuse(path, "cannot open it", errno);
    }
    const int fd = make_private(path, trust);
    if (fd != -1 && (flags & O_EXCL) != 0) return fd;
    // Closes the new file, and opens it again by its name. Else /proc/PID/fd, and so lsof, would
    // show "#123 (deleted)".
    if (fd != -1) ::close(fd);
    // EEXIST: another process has made the file since we looked.
    if (fd == -1 && (errno != EEXIST || (flags & O_EXCL) != 0)) {
      refuse(path, "cannot make it", errno);
    }
  }
}

bool is_name(std::string_view name) noexcept {
  const auto is_part = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
           c == '-' || c == '.';
  };
  return !name.empty() && name.size() <= 100 && name[0] != '.' &&
         std::all_of(name.begin(), name.end(), is_part) && !name.ends_with(".lock") &&
         !name.ends_with(".new");
}

std::string path_of(const std::string& directory, const std::string& name) {
  if (!is_name(name)) {
    throw Error(EINVAL, name, "not a name for a segment",
                "use 1 to 100 letters, digits, '_', '-' and '.', not beginning with '.' nor ending "
                "with .lock or .new");
  }
  return directory + "/" + name;
}

std::uint64_t check_of(const Capacity& c) noexcept {
  const std::uint64_t numbers[] = {c.size,   c.participants, c.blocks,
                                   c.topics, c.channels,     c.readers};
  return hash(reinterpret_cast<const char*>(numbers), sizeof(numbers));
}

bool means_damage(const Error& e) noexcept {
  return e.error_number() == EINVAL || e.error_number() == EBADMSG;
}

std::uint64_t topic_key(std::string_view name) { return hash(name.data(), name.size()) | 1; }

Geometry Geometry::of(const Capacity& c) {
  Geometry g{};
  std::uint64_t at = kGranule;
  auto table = [&at](std::uint64_t& place, std::uint64_t bytes) {
    place = at;
    at = round_up(at + bytes, 64);
  };
  const std::uint64_t all_granules = c.size / kGranule;
  table(g.participants, c.participants * sizeof(ParticipantEntry));
  table(g.witnesses, c.participants * sizeof(Witness));
  table(g.directory, sizeof(Directory));
  table(g.topics, c.topics * sizeof(TopicEntry));
  table(g.channels, c.channels * sizeof(ChannelEntry));
  table(g.blocks, c.blocks * sizeof(BlockWords));
  table(g.arenas, c.blocks * sizeof(detail::Arena));
  table(g.tags, all_granules * sizeof(Tag));
  table(g.units, units_of(c) * sizeof(Tag));
  table(g.sightings, c.participants * sizeof(Sightings));
  table(g.replies, c.topics * sizeof(Replies));
  table(g.descriptions, kDescriptionsBytes);
  table(g.listeners, c.channels * sizeof(Listeners));
  table(g.ears, ring::kEars * sizeof(EarWords));
  table(g.news, ring::kEars * news_bytes(c.channels));
  at = round_up(at, kGranule);  // payload begins on a page of its own
  table(g.small, c.blocks * kSmallBytes);
  g.data = round_up(at, kGranule);
  g.granules = g.data < c.size ? (c.size - g.data) / kGranule : 0;
  return g;
}

void Segment::create(const std::string& path, Capacity capacity, const Trust& trust) {
  capacity = choose_size(path, capacity);
  const Geometry geometry = Geometry::of(capacity);
  const std::string unfinished = path + ".new";
  // An unfinished file is from a creator that died, since we hold the gate. If it belongs to
  // another user, the next call fails.
  if (trust.owns(unfinished)) ::unlink(unfinished.c_str());
  Descriptor file(open_private(unfinished, trust, O_EXCL));
  const auto fail = [&](int error, const char* what) {
    ::unlink(unfinished.c_str());
    if ((error == EPERM || error == EACCES) && !may_remove(path)) {
      throw Error(error, path,
                  "cannot put a new segment in its place, it belongs to " + owner_and_mode(path),
                  "let its owner, or root, run " + command("clean", path) +
                      ", or set LOT_SEGMENT or LOT_DIR");
    }
    throw Error(error, path, what, "free memory in its directory, or set LOT_SIZE or LOT_DIR");
  };
  if (ftruncate(file.fd, static_cast<off_t>(capacity.size)) == -1) fail(errno, "cannot make it");
  const int error = reserve_new(file.fd, geometry.data);
  if (error != 0) fail(error, "cannot reserve memory for its tables");
  Header header{};
  std::memcpy(header.identity.magic, kMagic, sizeof(kMagic));
  header.identity.layout_version = kLayoutVersion;
  header.identity.header_bytes = sizeof(Header);
  header.identity.fingerprint = fingerprint();
  header.identity.size = capacity.size;
  header.identity.boot = boot();
  if (getrandom(&header.identity.instance, sizeof(std::uint64_t), 0) != sizeof(std::uint64_t)) {
    header.identity.instance = static_cast<std::uint64_t>(getpid());
  }
  header.capacity = capacity;
  header.check = check_of(capacity);
  if (pwrite(file.fd, &header, sizeof(header), 0) != sizeof(header)) fail(errno, "cannot write it");
  if (::rename(unfinished.c_str(), path.c_str()) == -1) fail(errno, "cannot name it");
}

Segment::Fit Segment::examine(const std::string& path, std::uint64_t size, const Trust& trust,
                              std::string& reason) {
  reason.clear();
  Descriptor file(open_file(path, O_RDWR | O_NOFOLLOW | O_NONBLOCK));
  if (file.fd == -1) {
    if (errno == ENOENT) return Fit::Absent;
    refuse(path, "cannot open the segment", errno);
  }
  const Fit fit = fit_of(file.fd, size, reason);
  if (const std::string kind = kind_of(path); fit == Fit::Foreign && !kind.empty()) {
    reason = "it is " + kind + ", no file of LOT";
  }
  // A file that is no segment is reported as such, whichever user owns it.
  if (fit != Fit::Foreign) trust.require(file.fd, path);
  if (fit == Fit::Fits) reason = trust.shortfall(file.fd);
  return fit == Fit::Fits && !reason.empty() ? Fit::Narrow : fit;
}

Segment::Fit Segment::inspect(const std::string& path, const Trust& trust, std::string& reason) {
  reason.clear();
  Descriptor file(open_file(path, O_RDONLY | O_NOFOLLOW | O_NONBLOCK));
  if (file.fd == -1) {
    if (errno == ENOENT) return Fit::Absent;
    refuse(path, "cannot open it for reading", errno);
  }
  trust.require(file.fd, path);
  return fit_of(file.fd, 0, reason);
}

void Segment::remove(const std::string& path, const Trust& trust) noexcept {
  const std::string unfinished = path + ".new";
  if (trust.owns(path)) ::unlink(path.c_str());
  if (trust.owns(unfinished)) ::unlink(unfinished.c_str());
}

std::string Segment::other_size(std::uint64_t wanted) const {
  return size_objection(capacity_.size, wanted);
}

bool Segment::is_at_its_path() const noexcept {
  Descriptor file(open_file(path_, O_RDONLY | O_NOFOLLOW | O_NONBLOCK));
  std::uint64_t ignored = 0;
  return file.fd != -1 &&
         read_header(file.fd, ignored).identity.instance == header().identity.instance;
}

Segment::Segment(const std::string& path, Access access, const Trust& trust) : path_(path) {
  const bool writable = access == Access::ReadWrite;
  Descriptor file(open_file(path, (writable ? O_RDWR : O_RDONLY) | O_NOFOLLOW | O_NONBLOCK),
                  writable ? boost::interprocess::read_write : boost::interprocess::read_only);
  if (file.fd == -1) refuse(path, "cannot open it", errno);
  trust.require(file.fd, path);
  std::uint64_t size = 0;
  const Header header = read_header(file.fd, size);
  if (const std::string why = objection(header, size); !why.empty()) {
    throw Error(EINVAL, path, why, "stop what uses it and remove it, or set LOT_SEGMENT");
  }
  capacity_ = header.capacity;
  geometry_ = Geometry::of(capacity_);
  try {
    region_ = map_file(file, size);
  } catch (const boost::interprocess::interprocess_exception& e) {
    throw Error(e.get_native_error(), path, "cannot map " + size_text(size) + " of address space",
                advice_on_address_space());
  }
  base_ = static_cast<unsigned char*>(region_.get_address());
  mapping_ = detail::Mapping::Scope(
      {base_, capacity_.size, geometry_.arenas, geometry_.small, geometry_.data, capacity_.blocks});
  blocks_ = at<BlockWords>(geometry_.blocks);
  arenas_ = at<detail::Arena>(geometry_.arenas);
  builds_ = detail::Build::of(arena(0));
  small_ = at<unsigned char>(geometry_.small);
  granules_.reset(at<Tag>(geometry_.tags), static_cast<std::uint32_t>(geometry_.granules));
  units_.reset(at<Tag>(geometry_.units), units_of(capacity_));
  mapped_ = std::vector<std::atomic<bool>>(units_.count());
}

std::span<ParticipantEntry> Segment::participants() const noexcept {
  return {at<ParticipantEntry>(geometry_.participants), capacity_.participants};
}
std::span<Witness> Segment::witnesses() const noexcept {
  return {at<Witness>(geometry_.witnesses), capacity_.participants};
}
std::span<Sightings> Segment::sightings() const noexcept {
  return {at<Sightings>(geometry_.sightings), capacity_.participants};
}
Directory& Segment::directory() const noexcept { return *at<Directory>(geometry_.directory); }
std::span<TopicEntry> Segment::topics() const noexcept {
  return {at<TopicEntry>(geometry_.topics), capacity_.topics};
}
std::span<Replies> Segment::replies() const noexcept {
  return {at<Replies>(geometry_.replies), capacity_.topics};
}
std::span<std::uint64_t> Segment::descriptions() const noexcept {
  return {at<std::uint64_t>(geometry_.descriptions), kDescriptionsBytes / sizeof(std::uint64_t)};
}
std::span<ChannelEntry> Segment::channels() const noexcept {
  return {at<ChannelEntry>(geometry_.channels), capacity_.channels};
}

std::span<Listeners> Segment::listeners() const noexcept {
  return {at<Listeners>(geometry_.listeners), capacity_.channels};
}
Ear Segment::ear(std::uint32_t e) const noexcept {
  return {at<EarWords>(geometry_.ears) + e,
          at<std::atomic<ring::Word>>(geometry_.news + e * news_bytes(capacity_.channels))};
}

void Segment::ring_ears(std::uint32_t channel) const noexcept {
  ring_ears(channel, [](const void* bell, bool is_asleep) {
    if (is_asleep) futex::wake_all(bell);
  });
}

std::optional<std::uint32_t> Segment::claim_ear(std::uint32_t participant) const noexcept {
  for (std::uint32_t e = kFirstFreeEar; e < ring::kEars; ++e) {
    if (ear(e).words->owner.claim(participant)) return e;
  }
  return std::nullopt;
}

void Segment::free_ear(std::uint32_t e) const noexcept {
  for (Listeners& of_channel : listeners()) of_channel.remove(e);
  if (e >= kFirstFreeEar) ear(e).words->owner.free();
}

void Segment::free_ears(std::uint32_t participant) const noexcept {
  free_ear(participant);
  for (std::uint32_t e = kFirstFreeEar; e < ring::kEars; ++e) {
    if (ear(e).words->owner.is(participant)) free_ear(e);
  }
}

namespace {
constexpr std::uint64_t claim_bytes(std::uint32_t depth) { return round_up(depth * 8ULL, 64); }
/// From the begin of a ring's memory to its slots. That memory begins with a granule.
constexpr std::uint64_t before_slots(std::uint32_t readers, std::uint16_t stride) {
  return round_up(sizeof(RingHead) + readers * 4ULL, std::max<std::uint64_t>(stride, 64));
}
}  // namespace

std::uint64_t Segment::SlotShape::bytes() const noexcept {
  return stride != 0 ? std::uint64_t{places()} * stride : round_up(depth * 8ULL, 64);
}

std::uint64_t Segment::ring_bytes(const SlotShape& slots, std::uint32_t readers, bool finished,
                                  std::uint32_t extra) noexcept {
  return before_slots(readers, slots.stride) + slots.bytes() + readers * sizeof(Cell) +
         (finished ? claim_bytes(slots.depth) : 0) + std::uint64_t{readers} * extra;
}

bool Segment::holds(std::uint32_t b, std::uint64_t offset, std::uint64_t bytes) const noexcept {
  const std::uint64_t own_small = geometry_.small + b * kSmallBytes;
  if (offset >= own_small && offset < own_small + kSmallBytes) {
    return bytes <= own_small + kSmallBytes - offset;
  }
  const std::uint64_t end = geometry_.data + geometry_.granules * kGranule;
  if (offset < geometry_.data || offset >= end || bytes == 0 || bytes > end - offset) return false;
  const auto first = static_cast<std::uint32_t>((offset - geometry_.data) / kGranule);
  const auto last = static_cast<std::uint32_t>((offset + bytes - 1 - geometry_.data) / kGranule);
  return granules_.tag(first) == b + 1 && granules_.tag(last) == b + 1;
}

Ring Segment::ring(std::uint32_t channel) const noexcept {
  ChannelEntry& entry = channels()[channel];
  // R13, edge "formed"
  if (entry.formed.load(std::memory_order_seq_cst) != 0) return unformed_ring(channel);
  Ring ring;
  ring.writer = &entry.writer;
  ring.channel = channel;
  return ring;
}

Ring Segment::unformed_ring(std::uint32_t channel) const noexcept {
  ChannelEntry& entry = channels()[channel];
  Ring ring;
  ring.writer = &entry.writer;
  ring.channel = channel;
  // Reads each field once: a process that changes it meanwhile cannot get past the checks.
  const std::uint32_t depth = detail::read_once(entry.depth);
  const std::uint32_t readers = detail::read_once(entry.readers);
  const std::uint32_t granule = detail::read_once(entry.granule);
  const std::uint32_t granules = detail::read_once(entry.granules);
  const std::uint32_t engine = detail::read_once(entry.engine);
  const std::uint32_t taken = detail::read_once(entry.taken);
  const bool blocking =
      detail::read_once(entry.policy) != static_cast<std::uint32_t>(Policy::Overwrite);
  const SlotShape slots{depth, detail::read_once(entry.stride), taken == 0 || !blocking};
  const std::uint32_t extra = detail::read_once(entry.extra);
  if (depth == 0 || depth > kDeepest || readers == 0 || readers > capacity_.readers ||
      granule >= geometry_.granules || granules > geometry_.granules - granule ||
      (extra != 0 && extra != kExtraBytes) || taken > kFinished ||
      (taken == kFinished && !blocking) ||  // a claim for each of `depth` slots
      (slots.stride != 0 &&
       std::count(std::begin(kStrides), std::end(kStrides), slots.stride) == 0) ||
      ring_bytes(slots, readers, taken == kFinished, extra) > kGranule * granules ||
      engine > static_cast<std::uint32_t>(QueueEngine::Mutex)) {
    return ring;
  }
  for (std::uint32_t i = 0; i < granules; ++i) {
    if (granules_.tag(granule + i) != (kRingTag | channel)) return ring;
  }
  const std::uint64_t begin = granule_offset(granule);
  auto* head = at<RingHead>(begin);
  if (engine == static_cast<std::uint32_t>(QueueEngine::Mutex)) ring.arrived = &head->lock.arrived;
  ring.roster = &head->roster;
  ring.space = &head->space;
  ring.floor = &head->floor;
  ring.who = at<std::atomic<std::uint32_t>>(begin + sizeof(RingHead));
  std::uint64_t place = begin + before_slots(readers, slots.stride);
  auto* const words = at<std::atomic<ring::Word>>(place);
  ring.slots = slots.stride != 0 ? ring::Slots<Atomics>::with_messages(words, slots.stride)
                                 : ring::Slots<Atomics>(words);
  place += slots.bytes();
  ring.cells = at<Cell>(place);
  place += readers * sizeof(Cell);
  if (taken == kFinished) {
    ring.claims = at<std::atomic<ring::Word>>(place);
    ring.returned = &head->returned;
    place += claim_bytes(depth);
  }
  if (extra != 0) ring.extra = at<unsigned char>(place);
  ring.depth = depth;
  ring.readers = readers;
  ring.blocking = blocking;
  ring.taken = taken != 0;
  ring.first = detail::read_once(entry.first);
  return ring;
}

std::uint32_t Segment::waiting_items(std::uint32_t channel) const noexcept {
  const ring::Word writer = channels()[channel].writer.load(std::memory_order_acquire);  // R7
  const ring::State state = ring::writer_state(writer);
  if (state != ring::State::Live && state != ring::State::Orphan) return 0;
  const Ring r = ring(channel);
  std::uint32_t items = 0;
  for (std::uint32_t i = 0; r.taken && i < r.places(); ++i) {
    // Relaxed: the items are only counted.
    items += ring::block(r.slots[i].load(std::memory_order_relaxed)) != ring::kNoBlock;
  }
  return items;
}

void Segment::construct_queue_lock(const Ring& ring) noexcept {
  if (ring.arrived == nullptr) return;
  ring.arrived->store(0, std::memory_order_relaxed);       // R7 carries it
  lock_of(ring).held.store(0, std::memory_order_relaxed);  // R7 carries it
}

mutex_engine::QueueLock Segment::queue_lock(std::uint32_t channel,
                                            LockOwner& owner) const noexcept {
  const Ring r = ring(channel);
  if (r.arrived == nullptr) return {};
  return {lock_of(r), *r.space, owner, path_};
}

std::uint32_t Segment::claim_run(std::uint32_t granules, std::uint32_t tag) noexcept {
  errno = 0;
  std::uint32_t run = granules_.claim(granules, tag);
  if (run == Granules<Atomics>::kNone || back_run(run, granules)) return run;
  granules_.release(run, granules);
  for (int tries = 0; tries < 2; ++tries) {
    run = granules_.claim(granules, tag,
                          [&](std::uint32_t first) { return is_backed(first, granules); });
    if (run == Granules<Atomics>::kNone) break;
    if (back_run(run, granules)) return run;
    granules_.release(run, granules);  // another process has given its memory back meanwhile
  }
  errno = ENOSPC;
  return Granules<Atomics>::kNone;
}

void Segment::keep_run(std::uint32_t first, std::uint32_t granules) noexcept {
  units_.keep(unit_of(first), unit_of(first + granules - 1));
}

bool Segment::extend_run(std::uint32_t end, std::uint32_t granules, std::uint32_t tag) noexcept {
  if (!granules_.extend(end, granules, tag)) return false;
  if (back_run(end, granules)) return true;
  granules_.release(end, granules);
  return false;
}

std::uint32_t Segment::unit_of(std::uint32_t granule) const noexcept {
  return static_cast<std::uint32_t>(granule_offset(granule) / kUnit);
}

std::uint32_t Segment::left_in_unit(std::uint32_t granule) const noexcept {
  return static_cast<std::uint32_t>((kUnit - granule_offset(granule) % kUnit) / kGranule);
}

bool Segment::back_run(std::uint32_t first, std::uint32_t granules) noexcept {
  const std::uint32_t last = unit_of(first + granules - 1);
  if (!units_.get(unit_of(first), last, [this](std::uint32_t unit) { return populate(unit); })) {
    return false;
  }
  // Memory that other processes have used is there, but not mapped in this process.
  for (std::uint32_t unit = unit_of(first); granules >= kMappedAtOnce && unit <= last; ++unit) {
    map_unit(unit);
  }
  return true;
}

void Segment::map_for_writing(std::uint32_t first, std::uint32_t granules) noexcept {
  const std::uint32_t last = unit_of(first + granules - 1);
  int error = 0;
  for (std::uint32_t unit = unit_of(first); error == 0 && unit <= last; ++unit) {
    error = map_unit(unit);
  }
  // Linux before 5.14: writes a byte of each granule with its own value. Volatile, since a compiler
  // may leave out an atomic addition of 0.
  for (std::uint32_t i = 0; error != 0 && i < granules; ++i) {
    volatile unsigned char& byte = base_[granule_offset(first + i)];
    byte = byte;
  }
}

bool Segment::can_back_run(std::uint32_t first, std::uint32_t granules) noexcept {
  return units_.try_get(unit_of(first), unit_of(first + granules - 1),
                        [this](std::uint32_t unit) { return populate(unit); });
}

bool Segment::is_backed(std::uint32_t first, std::uint32_t granules) const noexcept {
  return units_.has(unit_of(first), unit_of(first + granules - 1));
}

std::uint64_t Segment::bytes_of_unit(std::uint32_t unit) const noexcept {
  return std::min(kUnit, size() - unit * kUnit);
}

Segment::Run Segment::run_of_unit(std::uint32_t unit) const noexcept {
  return {static_cast<std::uint32_t>((unit * kUnit - geometry_.data) / kGranule),
          static_cast<std::uint32_t>(bytes_of_unit(unit) / kGranule)};
}

void Segment::look_at_units() noexcept {
  for (std::uint32_t unit = first_unit(); unit < units_.count(); ++unit) {
    units_.look(unit, [this](std::uint32_t u) {
      const Run run = run_of_unit(u);
      return !granules_.is_free(run.first, run.granules);
    });
  }
}

bool Segment::is_unused(std::uint32_t unit, std::uint32_t looks) const noexcept {
  const Run run = run_of_unit(unit);
  return units_.is_old(unit, looks) && granules_.is_free(run.first, run.granules);
}

std::uint64_t Segment::give_back(std::uint32_t unit, std::uint32_t looks,
                                 std::uint32_t tag) noexcept {
  const Run run = run_of_unit(unit);
  const std::uint64_t bytes = kGranule * run.granules;
  const auto punch = [&] {
    mapped_[unit].store(false, std::memory_order_relaxed);  // a hint
    const bool gone = madvise(base_ + unit * kUnit, bytes, MADV_REMOVE) == 0;
    if (!gone) can_give_back_.store(false, std::memory_order_relaxed);  // a hint
    return gone;
  };
  const bool gone = units_.give_back(unit, looks, granules_, run.first, run.granules, tag, punch,
                                     [this](std::uint32_t u) { return populate(u); });
  return gone ? bytes : 0;
}

/// Gets the memory of a unit from the system before LOT uses it. So a full file system is an error
/// here, and not a SIGBUS later. To do it twice does no harm.
bool Segment::populate(std::uint32_t unit) noexcept {
  const std::uint64_t begin = unit * kUnit;
  const std::uint64_t bytes = bytes_of_unit(unit);
  // Relaxed: a hint. The memory had gone, perhaps by another process.
  mapped_[unit].store(false, std::memory_order_relaxed);
  const int error = map_unit(unit);
  if (error == 0) return true;
  errno = error;
  if (!is_refused(error)) return false;
  // Else asks through the file, if the path still leads to this segment.
  Descriptor file(open_file(path_, O_RDWR | O_NOFOLLOW));
  std::uint64_t ignored = 0;
  return file.fd != -1 &&
         read_header(file.fd, ignored).identity.instance == header().identity.instance &&
         posix_fallocate(file.fd, static_cast<off_t>(begin), static_cast<off_t>(bytes)) == 0;
}

/// Maps a unit. It changes no byte, so the memory may belong to others: pages that are there are
/// only mapped.
int Segment::map_unit(std::uint32_t unit) noexcept {
  if (mapped_[unit].load(std::memory_order_relaxed)) return 0;  // a hint
#ifdef MADV_POPULATE_WRITE
  constexpr int kPopulateWrite = MADV_POPULATE_WRITE;
#else
  constexpr int kPopulateWrite = 23;
#endif
  int result;
  do {
    result = madvise(base_ + unit * kUnit, bytes_of_unit(unit), kPopulateWrite);
  } while (result == -1 && (errno == EINTR || errno == EAGAIN));
  if (result == -1) return errno;
  mapped_[unit].store(true, std::memory_order_relaxed);  // a hint
  return 0;
}

void Segment::lock_memory() {
  if (mlock2(base_, size(), MLOCK_ONFAULT) == -1) {
    const int error = errno;
    rlimit limit{};
    getrlimit(RLIMIT_MEMLOCK, &limit);
    throw Error(error, path_,
                "cannot lock its " + size_text(size()) + ": RLIMIT_MEMLOCK is " +
                    std::to_string(limit.rlim_cur >> 10) + " KiB",
                "raise the limit (ulimit -l, LimitMEMLOCK=, docker run --ulimit memlock=-1), give "
                "CAP_IPC_LOCK, leave LOT_MLOCK and EngineOptions::lock_memory away, or have the "
                "segment made anew with a smaller LOT_SIZE, when all that use it have ended");
  }
  is_locked_.store(true, std::memory_order_relaxed);       // a flag that tells nothing else
  can_give_back_.store(false, std::memory_order_relaxed);  // MADV_REMOVE refuses locked memory
}

}  // namespace lot::segment
