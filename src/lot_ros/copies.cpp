// SPDX-License-Identifier: Apache-2.0
#include "lot_ros/copies.hpp"

#include <cstdint>
#include <cstring>

#include <link.h>

// The note: the length of its name, that of its contents, its type, and its name.
asm(R"(
  .pushsection .note.lot.ros, "a", %note
  .balign 4
  .long 4
  .long 0
  .long 1
  .asciz "LOT"
  .popsection
)");

namespace lot::ros {
namespace {

constexpr char kName[] = "LOT";
constexpr std::uint32_t kType = 1;

struct Search {
  std::uintptr_t ours;  ///< an address in the copy that asks
  std::string earlier;
};

bool is_ours(const dl_phdr_info& object, const ElfW(Phdr) & part, std::uintptr_t address) {
  return part.p_type == PT_LOAD && address - (object.dlpi_addr + part.p_vaddr) < part.p_memsz;
}

/// True when this part of a file holds our note.
bool has_note(const dl_phdr_info& object, const ElfW(Phdr) & part) {
  if (part.p_type != PT_NOTE) return false;
  const auto* at = reinterpret_cast<const char*>(object.dlpi_addr + part.p_vaddr);
  const std::size_t step = part.p_align == 8 ? 8 : 4;
  const auto padded = [step](std::size_t n) { return (n + step - 1) / step * step; };
  for (std::size_t left = part.p_memsz; left >= sizeof(ElfW(Nhdr));) {
    ElfW(Nhdr) note;
    std::memcpy(&note, at, sizeof(note));
    if (note.n_type == kType && note.n_namesz == sizeof(kName) &&
        left >= sizeof(note) + sizeof(kName) &&
        std::memcmp(at + sizeof(note), kName, sizeof(kName)) == 0) {
      return true;
    }
    const std::size_t size = padded(padded(sizeof(note) + note.n_namesz) + note.n_descsz);
    if (size > left) return false;
    at += size;
    left -= size;
  }
  return false;
}

/// Looks at one loaded object. They come in the order in which they were loaded. Returns 0 to see
/// the next one.
int look(dl_phdr_info* object, std::size_t, void* data) {
  auto& search = *static_cast<Search*>(data);
  bool has = false;
  for (int i = 0; i < object->dlpi_phnum; ++i) {
    if (is_ours(*object, object->dlpi_phdr[i], search.ours)) return 1;
    has = has || has_note(*object, object->dlpi_phdr[i]);
  }
  if (!has) return 0;
  search.earlier = *object->dlpi_name != '\0' ? object->dlpi_name : "the program itself";
  return 1;
}

}  // namespace

std::string earlier_copy() {
  Search search{reinterpret_cast<std::uintptr_t>(&look), {}};
  dl_iterate_phdr(&look, &search);
  return search.earlier;
}

}  // namespace lot::ros
