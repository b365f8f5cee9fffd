// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <iosfwd>
#include <string>

#include "measures.hpp"
#include "result.hpp"

namespace ab {

struct ReportOptions {
  bool per_subscriber = false;  ///< a row for each; else one for all subscribers of a stream
  Stamp stamp = Stamp::Fill;    ///< from which latencies count, and what is made of them
};

/// Tables for a terminal of 120 columns: of each cell what arrived when, what that is beside ring,
/// then what it cost; what was refused and why at the end. Says it loudly where sent = received +
/// missed + lost does not hold or a payload was spoilt.
void print(std::ostream&, const Run&, const ReportOptions& = {});

/// One cell of it: for a harness that prints what it has as it goes.
void print(std::ostream&, const Cell&, const ReportOptions& = {});

/// True if nothing is wrong with any subscriber's counts: what print() is loud about.
bool counts_add_up(const Cell&);

/// The conditions in one line, as a user would say them.
std::string title_of(const Conditions&);
/// "128 B", "64 KiB", "16 MiB".
std::string size_word(std::size_t bytes);
/// Three digits or more, no needless ones: "0.143", "33.1", "5300".
std::string number(double value);
/// "1.02 (1.00-1.04)"; without an interval "1.02".
std::string ratio_word(const Ratio&);

}  // namespace ab
