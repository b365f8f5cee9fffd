// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <type_traits>
#include <utility>

#include <boost/container/deque.hpp>
#include <boost/container/flat_map.hpp>
#include <boost/container/flat_set.hpp>
#include <boost/container/list.hpp>
#include <boost/container/map.hpp>
#include <boost/container/set.hpp>
#include <boost/container/slist.hpp>
#include <boost/container/small_vector.hpp>
#include <boost/container/stable_vector.hpp>
#include <boost/container/static_vector.hpp>

#include "lot/compliance.hpp"
#include "lot/message.hpp"

/// Boost's containers in messages: lists, trees and flat maps, which std can not have there, since
/// its nodes are linked by raw pointers. Opt-in: nothing else in include/lot needs Boost.
///
///     struct Objects { lot::ShmMap<std::uint32_t, lot::ShmString> names; };
///     objects->names[7] = "pedestrian";      // node and text lie in the message
///
/// They are Boost.Container's, which Boost.Interprocess has under its own name as well. Any of them
/// with another allocator, order or hash is searched like every container: a stateful order is part
/// of the message. ShmVector and ShmString are all that is needed of vectors and strings, but
/// Boost's work too.
namespace lot {

/// A double-ended queue: elements stay where they are when it grows at an end.
template <class T>
using ShmDeque = boost::container::deque<T, ShmAllocator<T>>;
/// A list that is linked both ways.
template <class T>
using ShmList = boost::container::list<T, ShmAllocator<T>>;
/// A list that is linked forwards only.
template <class T>
using ShmSlist = boost::container::slist<T, ShmAllocator<T>>;
/// Elements never move, however it grows. After OutOfMemory it is of no more use, until it is
/// swapped with an empty one: without NDEBUG an assertion of Boost 1.74 ends the program.
template <class T>
using ShmStableVector = boost::container::stable_vector<T, ShmAllocator<T>>;
/// The first N elements lie in the container itself.
template <class T, std::size_t N>
using ShmSmallVector = boost::container::small_vector<T, N, ShmAllocator<T>>;

/// A tree of keys and values.
template <class Key, class T, class Compare = std::less<Key>>
using ShmMap = boost::container::map<Key, T, Compare, ShmAllocator<std::pair<const Key, T>>>;
/// A tree that may have a key several times.
template <class Key, class T, class Compare = std::less<Key>>
using ShmMultimap =
    boost::container::multimap<Key, T, Compare, ShmAllocator<std::pair<const Key, T>>>;
/// A tree of keys.
template <class Key, class Compare = std::less<Key>>
using ShmSet = boost::container::set<Key, Compare, ShmAllocator<Key>>;
/// A tree of keys that may have a key several times.
template <class Key, class Compare = std::less<Key>>
using ShmMultiset = boost::container::multiset<Key, Compare, ShmAllocator<Key>>;

/// A map that is a sorted vector: the quickest to read in place.
template <class Key, class T, class Compare = std::less<Key>>
using ShmFlatMap = boost::container::flat_map<Key, T, Compare, ShmAllocator<std::pair<Key, T>>>;
/// A sorted vector of keys and values that may have a key several times.
template <class Key, class T, class Compare = std::less<Key>>
using ShmFlatMultimap =
    boost::container::flat_multimap<Key, T, Compare, ShmAllocator<std::pair<Key, T>>>;
/// A sorted vector of keys.
template <class Key, class Compare = std::less<Key>>
using ShmFlatSet = boost::container::flat_set<Key, Compare, ShmAllocator<Key>>;
/// A sorted vector of keys that may have a key several times.
template <class Key, class Compare = std::less<Key>>
using ShmFlatMultiset = boost::container::flat_multiset<Key, Compare, ShmAllocator<Key>>;

/// A small_vector's own allocator adds nothing to the one that it is made of.
template <class T, class Allocator, class Options>
struct is_shm_allocator<boost::container::small_vector_allocator<T, Allocator, Options>>
    : is_shm_allocator<Allocator> {};

namespace detail {
/// Its elements lie in itself, and it has no pointer to them.
template <class T, std::size_t N, class Options>
struct StdParts<boost::container::static_vector<T, N, Options>> : KnownParts<T> {};
}  // namespace detail

}  // namespace lot
