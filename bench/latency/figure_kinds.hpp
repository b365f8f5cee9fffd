// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "result.hpp"

/// The kinds of figures, each in a file of its own. `machine` is for subtitles, `dir` where figures
/// go; each line says what was drawn or why not, as of draw().
namespace ab {

/// Box plots over the message's size: 3, 5, 6 a-c, 7, peers, peers-spin (box_figures.cpp).
std::vector<std::string> draw_box_figures(const Run&, const std::string& machine,
                                          const std::filesystem::path& dir);
/// Figures 6 d and ros6d: message by message (time_figures.cpp, as the others).
std::vector<std::string> draw_nagle(const Run&, const std::string& machine,
                                    const std::filesystem::path& dir);
/// Figure 8: CPU use over time.
std::string draw_load(const Run&, const std::string& machine, const std::filesystem::path& dir);
/// Table 1: CPU seconds and hot spots.
std::string write_load_table(const Run&, const std::filesystem::path& dir);

}  // namespace ab
