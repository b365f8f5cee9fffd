// SPDX-License-Identifier: Apache-2.0

#include <lot/lot.hpp>

void wrong(lot::ShmEngine& engine) { engine.queue<int[4]>("q"); }
