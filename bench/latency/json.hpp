// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <vector>

#include "result.hpp"
#include "resume.hpp"

/// Keeps runs: DIR/run.json with all but the samples, and what they come to (statistics in us,
/// ratios); DIR/raw/ with the samples, one CSV file for each stream and subscriber.
///
/// A raw file begins with the line `publisher,number,block,loaned_ns,fill_ns,push_ns,entry_ns`:
/// loaned_ns is CLOCK_MONOTONIC, the others are nanoseconds since it. Its name ends with a checksum
/// of what it holds, so that no file is ever changed: run.json, which is renamed into place when
/// all raw files are there, names those that belong to it, and others are removed after that. So
/// who is killed here leaves what was there before, and at most some files too many.
///
/// Of each stream "all" has what its subscribers come to together: to_ring, to_floor-spin and
/// to_floor-futex are ratios (median, p99, fairness_gap: the gap's median) with their 95 %
/// intervals, from each stamp or by whole blocks, and rank_p, the rank test's p of block medians;
/// cpu_net_of_pacing (or cpu, where there was no floor-pace): the ratio of processor time per
/// message. Those of a quiet arm are to other quiet ones; to_quiet is to its own quiet twin.
/// block_costs are what each block cost all publishers and all subscribers; daemon_cpu_us what a
/// process that serves the nodes used during the arm's turns.
///
/// Errors: std::runtime_error with the file's name, and std::filesystem::filesystem_error.
/// Threads and processes: one writer to a directory at a time.
namespace ab {

/// Makes `dir` hold this run and nothing else.
void save(const Run&, const std::filesystem::path& dir);

/// Adds this run's cells to those in `dir` (which need not exist); a cell with equal conditions is
/// replaced. All else (machine, command, started) is that of the newest run. A directory whose run
/// is of a machine with another CPU, number of cores or kernel is refused: std::invalid_argument.
void add(const Run&, const std::filesystem::path& dir);

/// The cells in `dir`, with the names of those of their arms that did not fail (what was refused
/// did not: it would be again). None if there is no run. Refuses what add() would refuse to a run
/// of this machine.
std::vector<CellArms> saved_cells(const std::filesystem::path& dir, const Machine& machine);

/// `path`: a run.json, or the directory with it.
Run load(const std::filesystem::path& path);

/// One word for a cell, unique to its conditions, fit for a file's name.
std::string word_of(const Conditions&);

}  // namespace ab
