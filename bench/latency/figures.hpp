// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "result.hpp"

namespace ab {

/// Draws the paper's figures from this run into dir/figures: for each figure its data (NAME.tsv,
/// microseconds), a script (NAME.gp), and what gnuplot makes of them (NAME.svg, NAME.png); table 1
/// as table1.md. `gnuplot NAME.gp` in that directory draws one again.
///
/// Returns a line for each figure: where it is, or why it was left out (which cells it lacks).
/// Errors: std::runtime_error where a file cannot be written; without gnuplot the scripts and data
/// are written all the same, and the line says so.
std::vector<std::string> draw(const Run&, const std::filesystem::path& dir);

}  // namespace ab
