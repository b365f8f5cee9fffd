// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "lot/error.hpp"
#include "lot/recording.hpp"

#include "mcap/reader.hpp"
#include "mcap/recover.hpp"
#include "tool/commands.hpp"
#include "tool/onlooker.hpp"
#include "tool/report.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

/// "2026-11-30 02:19:48.125 UTC"
std::string time_text(RecordedTime time) {
  const auto since = time.time_since_epoch();
  const auto whole = std::chrono::floor<std::chrono::seconds>(since);
  const std::time_t seconds = whole.count();
  std::tm parts{};
  char text[64];
  if (gmtime_r(&seconds, &parts) == nullptr) return std::to_string(since.count()) + " ns";
  const std::size_t length = std::strftime(text, sizeof(text), "%Y-%m-%d %H:%M:%S", &parts);
  const auto rest = std::chrono::duration_cast<std::chrono::milliseconds>(since - whole).count();
  std::snprintf(text + length, sizeof(text) - length, ".%03d UTC", static_cast<int>(rest));
  return text;
}

/// A file that is larger takes so long to read that it is said before.
constexpr std::uint64_t kLarge = std::uint64_t{4} << 30;

double seconds_of(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

class Info {
 public:
  Info(const Settings& settings, const InfoOptions& options)
      : options_(options), report_(settings) {}

  Exit run() {
    report_.document()["command"] = "info";
    report_.document()["files"] = Json::array();
    bool is_first = true;
    for (const std::string& file : options_.files) {
      if (!std::exchange(is_first, false)) report_.print("\n");
      Json entry;
      entry["path"] = file;
      try {
        if (options_.recover) recover(file);
        tell(file, entry);
      } catch (const Error& e) {
        report_.print(printable(file, 200) + "\n");
        report_.hint(printable(reason_of(e), kLine));
        report_.ends(e.error_number() == EINVAL ? kDamaged : kWrong);
        entry = {{"path", file}, {"error", reason_of(e)}};
      }
      report_.document()["files"].push_back(std::move(entry));
    }
    return report_.finish();
  }

 private:
  void recover(const std::string& file) {
    const mcap::Recovered done = mcap::recover(file);
    if (done.was_whole) return;
    const std::string cut = bytes_text(done.cut_bytes);
    report_.hint(printable(file, 200) + ": its index is written; " +
                 (done.cut_bytes == 0 ? "nothing had to be cut off"
                  : done.cut_old_end
                      ? "it replaces the old one of " + cut + ": no message was there"
                      : cut + " behind the last whole record are cut off"));
  }

  struct Damage {
    RecordingDamage what;
    std::uint64_t messages;  ///< that the index has, and that cannot be read
  };
  /// What cannot be read of a file. Where it has no index, opening it has read all of it.
  Damage damage_of(const std::string& file, const Recording& recording, const mcap::Reader& reader,
                   std::uint64_t bytes) const {
    Damage damage{recording.damage(), 0};
    if (options_.quick || !reader.has_summary()) return damage;
    if (bytes > kLarge) {
      std::fprintf(stderr, "* reads %s, %s: `lot info --quick` reads only the index\n",
                   printable(file, 200).c_str(), bytes_text(bytes).c_str());
    }
    mcap::Stream stream(file);
    std::uint64_t read = 0;
    while (stream.next()) ++read;
    damage.messages = reader.statistics().messages - std::min(reader.statistics().messages, read);
    damage.what.chunks = stream.damage().chunks;
    damage.what.records = stream.damage().records;
    damage.what.bytes = stream.damage().bytes;
    damage.what.first = stream.damage().first;
    return damage;
  }

  void tell(const std::string& file, Json& entry) {
    Recording recording(file);
    const mcap::Reader reader(file);
    const auto bytes = std::filesystem::file_size(file);
    tell_file(file, recording, reader, bytes, entry);
    tell_topics(recording, entry);
    tell_damage(file, damage_of(file, recording, reader, bytes), reader, entry);
  }

  void tell_damage(const std::string& file, const Damage& found, const mcap::Reader& reader,
                   Json& entry) {
    const RecordingDamage& damage = found.what;
    const std::string& summary_fault = reader.summary_fault();
    entry["damage"] = {{"chunks", damage.chunks}, {"records", damage.records},
                       {"bytes", damage.bytes},   {"messages", found.messages},
                       {"first", damage.first},   {"is_cut", damage.is_cut},
                       {"index", summary_fault}};
    if (!summary_fault.empty()) {
      report_.ends(kDamaged);
      report_.hint(printable(file, 200) + ": its index is damaged (" + printable(summary_fault) +
                   "), and all of the file was read in its place. `lot info --recover` writes the "
                   "index anew");
    }
    if (damage.is_cut) {
      report_.ends(kWrong);
      report_.hint(printable(file, 200) +
                   ": its recorder has not closed it: it was killed, or still writes. `lot info "
                   "--recover` writes the index of a file that no recorder writes any more");
    }
    if (!damage.first.empty()) {
      report_.ends(kDamaged);
      const std::string messages =
          found.messages == 0 ? "" : ", " + plural(found.messages, "message", "messages") + ",";
      report_.hint(printable(file, 200) + ": " + bytes_text(damage.bytes) + messages +
                   " cannot be read: " + printable(damage.first, kLine));
    }
    if (options_.quick && !reader.has_summary() && summary_fault.empty()) {
      report_.hint(printable(file, 200) + " has no index: --quick has read all of it as well");
    }
  }

  void tell_file(const std::string& file, const Recording& recording, const mcap::Reader& reader,
                 std::uint64_t bytes, Json& entry) {
    std::set<std::string> compressions;
    for (const mcap::ChunkIndex& chunk : reader.chunks()) {
      compressions.insert(chunk.compression.empty() ? "none" : chunk.compression);
    }
    std::string compression;
    for (const std::string& one : compressions) {
      compression += (compression.empty() ? "" : ", ") + one;
    }
    const std::chrono::nanoseconds span = recording.end() - recording.begin();
    entry["bytes"] = bytes;
    entry["library"] = reader.header().library;
    entry["profile"] = reader.header().profile;
    entry["has_summary"] = reader.has_summary();
    const bool is_checked = !options_.quick || !reader.has_summary();
    entry["checked"] = is_checked;
    entry["compression"] = compressions;
    entry["chunks"] = reader.chunks().size();
    entry["messages"] = reader.statistics().messages;
    entry["begin_ns"] = recording.begin().time_since_epoch().count();
    entry["end_ns"] = recording.end().time_since_epoch().count();
    report_.print(printable(file, 200) + "  " + bytes_text(bytes) + ", by " +
                  printable(reader.header().library) + "\n");
    if (reader.statistics().messages == 0) return report_.print("  no messages\n");
    char length[32];
    std::snprintf(length, sizeof(length), "%.3f s", seconds_of(span));
    report_.print("  from " + time_text(recording.begin()) + ", " + length + "; " +
                  plural(reader.chunks().size(), "chunk", "chunks") + ", compression " +
                  printable(compression) + (is_checked ? "" : ", not read (--quick)") + "\n");
  }

  void tell_topics(const Recording& recording, Json& entry) {
    entry["topics"] = Json::array();
    const double seconds = seconds_of(recording.end() - recording.begin());
    std::vector<std::string> head = {"TOPIC", "TYPE", "MESSAGES", "RATE", "MISSED", "LOST"};
    const auto has_rate_limit = [](const RecordedTopic& topic) { return topic.left_out != 0; };
    const bool has_left_out = std::ranges::any_of(recording.topics(), has_rate_limit);
    if (has_left_out) head.emplace_back("LEFT OUT");
    Table table(head, {0, 1});
    for (const RecordedTopic& topic : recording.topics()) {
      std::optional<double> rate;
      if (topic.messages > 1 && seconds > 0) {
        rate = static_cast<double>(topic.messages) / seconds;
      }
      std::vector<std::string> row = {printable(topic.name, 200),     printable(topic.type),
                                      std::to_string(topic.messages), rate ? rate_text(*rate) : "",
                                      std::to_string(topic.missed),   std::to_string(topic.lost)};
      if (has_left_out) row.push_back(std::to_string(topic.left_out));
      table.add(std::move(row));
      entry["topics"].push_back({{"name", topic.name},
                                 {"type", topic.type},
                                 {"encoding", topic.encoding},
                                 {"schema_encoding", topic.schema_encoding},
                                 {"messages", topic.messages},
                                 {"per_second", or_null(rate)},
                                 {"missed", topic.missed},
                                 {"lost", topic.lost},
                                 {"left_out", topic.left_out},
                                 {"objection", topic.objection}});
      if (!topic.objection.empty()) {
        report_.hint("`lot play` leaves it out: " + printable(topic.objection, 500));
      }
    }
    if (!table.empty()) report_.print(table.text());
  }

  const InfoOptions& options_;
  Report report_;
};

}  // namespace

Exit info(const Settings& settings, const InfoOptions& options) {
  return Info(settings, options).run();
}

}  // namespace lot::tool
