// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "documents.hpp"

/// Where the containers of a message lie.
namespace lot::outside {

struct Piece {
  const unsigned char* begin;
  std::size_t bytes;
  std::size_t align;
  std::size_t part = 0;  ///< of the document; 0: itself, or its first part
  const unsigned char* end() const { return begin + bytes; }
};
using Pieces = std::vector<Piece>;

template <class T>
void find_pieces(const T&, Pieces&) {}  // plain
template <class A, class B>
void find_pieces(const std::pair<A, B>& pair, Pieces& pieces);
inline void find_pieces(const ShmString& s, Pieces& pieces);
template <class T>
void find_pieces(const ShmVector<T>& v, Pieces& pieces);
template <class T>
void find_pieces(const ShmSmallVector<T, 8>& v, Pieces& pieces);
template <class K, class T>
void find_pieces(const ShmFlatMap<K, T>& map, Pieces& pieces);
template <class T>
void find_pieces(const ShmList<T>& c, Pieces& pieces);
template <class T>
void find_pieces(const ShmSlist<T>& c, Pieces& pieces);
template <class T>
void find_pieces(const ShmDeque<T>& c, Pieces& pieces);
template <class T>
void find_pieces(const ShmStableVector<T>& c, Pieces& pieces);
template <class K, class T>
void find_pieces(const ShmMap<K, T>& c, Pieces& pieces);
template <class K, class T>
void find_pieces(const ShmMultimap<K, T>& c, Pieces& pieces);
template <class K>
void find_pieces(const ShmSet<K>& c, Pieces& pieces);

/// Unless it lies in the container itself.
template <class C>
void add_buffer(const C& container, const void* begin, std::size_t bytes, std::size_t align,
                Pieces& pieces) {
  const auto* const at = static_cast<const unsigned char*>(begin);
  const auto* const self = reinterpret_cast<const unsigned char*>(&container);
  if (bytes != 0 && (at < self || at >= self + sizeof(C))) pieces.push_back({at, bytes, align});
}

/// Each element in a node of its own; of the node only the element can be seen.
template <class C>
void add_nodes(const C& c, Pieces& pieces) {
  using T = typename C::value_type;
  for (const T& element : c) {
    pieces.push_back({reinterpret_cast<const unsigned char*>(&element), sizeof(T), alignof(T)});
    find_pieces(element, pieces);
  }
}

template <class A, class B>
void find_pieces(const std::pair<A, B>& pair, Pieces& pieces) {
  find_pieces(pair.first, pieces);
  find_pieces(pair.second, pieces);
}
inline void find_pieces(const ShmString& s, Pieces& pieces) {
  add_buffer(s, s.data(), s.capacity() + 1, 1, pieces);
}
template <class T>
void find_pieces(const ShmVector<T>& v, Pieces& pieces) {
  // Of an empty vector data() is null, though it has memory.
  add_buffer(v, std::to_address(v.begin()), v.capacity() * sizeof(T), alignof(T), pieces);
  for (const T& element : v) find_pieces(element, pieces);
}
template <class T>
void find_pieces(const ShmSmallVector<T, 8>& v, Pieces& pieces) {
  add_buffer(v, v.data(), v.capacity() * sizeof(T), alignof(T), pieces);
}
template <class K, class T>
void find_pieces(const ShmFlatMap<K, T>& map, Pieces& pieces) {
  using Element = typename ShmFlatMap<K, T>::value_type;
  add_buffer(map, boost::movelib::iterator_to_raw_pointer(map.begin()),
             map.capacity() * sizeof(Element), alignof(Element), pieces);
}
template <class T>
void find_pieces(const ShmList<T>& c, Pieces& pieces) {
  add_nodes(c, pieces);
}
template <class T>
void find_pieces(const ShmSlist<T>& c, Pieces& pieces) {
  add_nodes(c, pieces);
}
template <class T>
void find_pieces(const ShmDeque<T>& c, Pieces& pieces) {
  add_nodes(c, pieces);
}
template <class T>
void find_pieces(const ShmStableVector<T>& c, Pieces& pieces) {
  add_nodes(c, pieces);
}
template <class K, class T>
void find_pieces(const ShmMap<K, T>& c, Pieces& pieces) {
  add_nodes(c, pieces);
}
template <class K, class T>
void find_pieces(const ShmMultimap<K, T>& c, Pieces& pieces) {
  add_nodes(c, pieces);
}
template <class K>
void find_pieces(const ShmSet<K>& c, Pieces& pieces) {
  add_nodes(c, pieces);
}

/// The document itself, and all that its containers have.
template <class D>
Pieces pieces_of(const D& document) {
  Pieces pieces{{reinterpret_cast<const unsigned char*>(&document), sizeof(D), alignof(D)}};
  std::size_t number = 0;
  const auto add = [&](const auto& part) {
    const std::size_t before = pieces.size();
    find_pieces(part, pieces);
    for (std::size_t i = before; i < pieces.size(); ++i) pieces[i].part = number;
    ++number;
  };
  std::apply([&](const auto&... part) { (add(part), ...); }, document.parts());
  return pieces;
}

}  // namespace lot::outside
