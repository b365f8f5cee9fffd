// SPDX-License-Identifier: Apache-2.0

#include <array>
#include <atomic>
#include <chrono>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>
#if __cplusplus >= 202002L
#include <span>
#endif

#include <doctest/doctest.h>

#include <lot/compliance.hpp>

// The searches happen while compiling, so most checks are static_asserts beside
// the type they are about; the cases at the end repeat the heart of them so that
// a test run shows it. What the compiler says is tested in tests/proof/compile_fail.
namespace {

// Stands for lot::ShmAllocator: it has state, and is not trivially copyable.
template <typename T>
class FakeAllocator {
 public:
  using value_type = T;
  FakeAllocator() noexcept : pool_(nullptr) {}
  template <typename U>
  FakeAllocator(const FakeAllocator<U>& other) noexcept : pool_(other.pool()) {}
  T* allocate(std::size_t n) { return std::allocator<T>().allocate(n); }
  void deallocate(T* p, std::size_t n) { std::allocator<T>().deallocate(p, n); }
  const std::shared_ptr<int>& pool() const { return pool_; }
  friend bool operator==(const FakeAllocator& a, const FakeAllocator& b) {
    return a.pool_ == b.pool_;
  }
  friend bool operator!=(const FakeAllocator& a, const FakeAllocator& b) { return !(a == b); }

 private:
  std::shared_ptr<int> pool_;
};

template <typename T>
using Vec = std::vector<T, FakeAllocator<T>>;
using Str = std::basic_string<char, std::char_traits<char>, FakeAllocator<char>>;

class Trusted {
 public:
  Trusted() = default;
  explicit Trusted(int x) : x_(x) {}
  int x() const { return x_; }

 private:
  int x_ = 0;
};
class TrustedNoDefault {
 public:
  TrustedNoDefault(int x, int y) : sum_(x + y) {}
  int sum() const { return sum_; }

 private:
  int sum_;
};
class TrustedExplicitDefault {
 public:
  explicit TrustedExplicitDefault() : n_(0) {}
  int n() const { return n_; }

 private:
  int n_;
};
union TrustedUnion {
  int i;
  float f;
};

}  // namespace

template <typename T>
struct lot::is_shm_allocator<FakeAllocator<T>> : std::true_type {};
template <>
struct lot::is_trusted_message<Trusted> : std::true_type {};
template <>
struct lot::is_trusted_message<TrustedNoDefault> : std::true_type {};
template <>
struct lot::is_trusted_message<TrustedExplicitDefault> : std::true_type {};
template <>
struct lot::is_trusted_message<TrustedUnion> : std::true_type {};

namespace {

using lot::is_message_v;
using lot::detail::Fault;
using lot::detail::Fields;
using lot::detail::Reason;

template <typename T, typename F>
inline constexpr bool finds = std::is_same_v<decltype(lot::detail::find_message_fault<T>()), F>;
template <typename T, Reason Why, typename... CulpritAndHolders>
inline constexpr bool refuses = finds<T, Fault<Why, CulpritAndHolders...>>;

// Values.
enum class Color : std::uint8_t { Red };
static_assert(lot::assert_message<int>());
static_assert(lot::assert_message<bool>());
static_assert(lot::assert_message<long double>());
static_assert(lot::assert_message<std::byte>());
static_assert(lot::assert_message<Color>());
static_assert(lot::assert_message<int[3][4]>());
static_assert(lot::assert_message<std::array<Color, 0>>());
static_assert(lot::assert_message<std::array<std::array<int, 3>, 3>>());
static_assert(lot::assert_message<std::pair<int, double>>());
static_assert(lot::assert_message<std::tuple<int, std::pair<char, bool>>>());
static_assert(lot::assert_message<std::complex<float>>());
static_assert(lot::assert_message<std::chrono::nanoseconds>());
static_assert(lot::assert_message<std::chrono::steady_clock::time_point>());
static_assert(lot::assert_message<std::atomic<std::uint64_t>>());

// Plain structs.
struct Empty {};
struct Point {
  double x, y, z;
};
struct Big {
  std::uint64_t seq;
  std::uint8_t data[16 << 20];
};
struct BigOfStructs {
  struct Cell {
    float value = 1.0F;
    Empty tag;
  };
  std::uint64_t seq;
  Cell cells[1 << 16];
  Point table[3][3];
  std::uint64_t check;
};
struct Odd {
  const int constant;
  volatile int moving;
  unsigned low : 3;
  unsigned high : 29;
  unsigned : 0;
  Empty tag;
  Empty tags[2];
  std::atomic<int> count;
  std::atomic<int> counts[4];
  Color color;
  bool flag;
  std::chrono::system_clock::time_point when;
  std::pair<int, int> range;
  std::complex<double> phase[2];
  Trusted trusted;
};
struct WithDefaults {
  int a = 1;
  std::array<Point, 4> path{};
  int b[2] = {1, 2};
};
struct Nested {
  Point a;
  struct {
    Point b;
    Odd c;
  } inner[2];
};
struct OnlyTrusted {
  Trusted t[2];
  Trusted u;
};
struct NoDefault {
  int n;
  Empty tag;
  std::pair<int, int> range;
  Point points[2];
  TrustedNoDefault t;
  char text[8];
};
struct NoDefaults {
  NoDefault a;
  TrustedNoDefault b;
};
struct ExplicitDefault {
  TrustedExplicitDefault t;
  int n;
};
struct ExplicitDefaultArray {
  TrustedExplicitDefault t[2];
  int n;
};
struct NoDefaultArray {
  TrustedNoDefault t[2];
  int n;
};
struct HoldsTrustedUnion {
  int kind;
  TrustedUnion value;
};
static_assert(lot::assert_message<Empty>());
static_assert(lot::assert_message<Point>());
static_assert(lot::assert_message<Big>());
static_assert(lot::assert_message<BigOfStructs>());
static_assert(lot::assert_message<Odd>());
static_assert(lot::assert_message<WithDefaults>());
static_assert(lot::assert_message<Nested>());
static_assert(lot::assert_message<Trusted>());
static_assert(lot::assert_message<OnlyTrusted>());
static_assert(lot::assert_message<HoldsTrustedUnion>());
static_assert(lot::assert_message<NoDefault>());
static_assert(refuses<NoDefaults, Reason::kUnclearMembers, NoDefaults>);
static_assert(refuses<NoDefaultArray, Reason::kUnclearMembers, NoDefaultArray>);
static_assert(Fields<NoDefault>::count == 6);
static_assert(lot::assert_message<ExplicitDefault>());
static_assert(refuses<ExplicitDefaultArray, Reason::kUnclearMembers, ExplicitDefaultArray>);
static_assert(Fields<Empty>::count == 0);
static_assert(Fields<Big>::count == 2);
static_assert(Fields<BigOfStructs>::count == 4);
static_assert(Fields<Odd>::count == 14);
static_assert(Fields<WithDefaults>::count == 3);
static_assert(Fields<Nested>::count == 2);
static_assert(std::is_same_v<lot::detail::field_types<Big>,
                             lot::detail::Types<std::uint64_t, std::uint8_t[16 << 20]>>);

// Containers in the segment.
struct Frame {
  std::uint32_t width, height;
  Str encoding;
  Vec<std::uint8_t> data;
};
struct Tree {
  int value;
  Vec<Tree> children;
};
struct Video {
  Vec<Frame> frames;
  std::array<Str, 2> names;
  Str more_names[3];
  Vec<Vec<Point>> tracks;
  Frame poster;
};
static_assert(lot::assert_message<Str>());
static_assert(lot::assert_message<Vec<int>>());
static_assert(lot::assert_message<Frame>());
static_assert(lot::assert_message<Tree>());
static_assert(lot::assert_message<Video>());
static_assert(Fields<Frame>::count == 4);
static_assert(Fields<Video>::count == 5);

// The limit of 40 members.
struct Forty {
  int a0, a1, a2, a3, a4, a5, a6, a7, a8, a9;
  Str b0, b1, b2, b3, b4, b5, b6, b7, b8, b9;
  char c0[9], c1[9], c2[9], c3[9], c4[9], c5[9], c6[9], c7[9], c8[9], c9[9];
  Empty d0, d1, d2, d3, d4, d5, d6, d7, d8;
  Point last;
};
struct FortyOne {
  int a0, a1, a2, a3, a4, a5, a6, a7, a8, a9;
  int b0, b1, b2, b3, b4, b5, b6, b7, b8, b9;
  int c0, c1, c2, c3, c4, c5, c6, c7, c8, c9;
  int d0, d1, d2, d3, d4, d5, d6, d7, d8, d9;
  int one_more;
};
static_assert(lot::assert_message<Forty>());
static_assert(Fields<Forty>::count == 40);
static_assert(refuses<FortyOne, Reason::kTooManyMembers, FortyOne>);

// Pointers, references and the like.
struct HasPointer {
  int n;
  const Point* p;
};
struct HasVoidPointer {
  void* p[2];
};
struct HasConstPointer {
  int* const p;
};
struct HasNull {
  std::nullptr_t p;
};
struct HasFunctionPointer {
  void (*f)(int);
};
struct HasMemberPointer {
  double Point::*member;
};
struct HasMemberFunctionPointer {
  int (Trusted::*member)() const;
};
struct HasReference {
  int n;
  int& r;
  char text[8];
};
struct HasConstReference {
  const Point& r;
};
struct HasRvalueReference {
  int n;
  Point&& r;
};
struct HasTwoReferences {
  int& a;
  Empty tag;
  std::pair<int, int> t;
  double b;
  const Empty e;
  Point& c;
};
struct HasReferenceWrapper {
  std::reference_wrapper<int> r;
};
static_assert(refuses<int*, Reason::kRawPointer, int*>);
static_assert(refuses<HasPointer, Reason::kRawPointer, const Point*, HasPointer>);
static_assert(refuses<HasVoidPointer, Reason::kRawPointer, void*, void* [2], HasVoidPointer>);
static_assert(refuses<HasConstPointer, Reason::kRawPointer, int*, HasConstPointer>);
static_assert(refuses<HasNull, Reason::kRawPointer, std::nullptr_t, HasNull>);
static_assert(
    refuses<HasFunctionPointer, Reason::kFunctionPointer, void (*)(int), HasFunctionPointer>);
static_assert(refuses<HasMemberPointer, Reason::kMemberPointer, double Point::*, HasMemberPointer>);
static_assert(!is_message_v<HasMemberFunctionPointer>);
static_assert(refuses<HasReference, Reason::kReference, int&, HasReference>);
static_assert(refuses<HasConstReference, Reason::kReference, const Point&, HasConstReference>);
static_assert(refuses<HasRvalueReference, Reason::kReference, Point&&, HasRvalueReference>);
static_assert(refuses<HasTwoReferences, Reason::kReference, int&, HasTwoReferences>);
static_assert(refuses<HasReferenceWrapper, Reason::kReference, std::reference_wrapper<int>,
                      HasReferenceWrapper>);
static_assert(Fields<HasReference>::count == 3);
static_assert(Fields<HasTwoReferences>::count == 6);
static_assert(refuses<std::pair<int, int*>, Reason::kRawPointer, int*, std::pair<int, int*>>);
static_assert(refuses<std::atomic<int*>, Reason::kRawPointer, int*, std::atomic<int*>>);

struct Level3 {
  int n;
  int* p;
};
struct Level2 {
  Point a;
  std::array<Level3, 2> b;
};
struct Level1 {
  Str name;
  Vec<Level2> c;
};
static_assert(refuses<Level1, Reason::kRawPointer, int*, Level3, std::array<Level3, 2>, Level2,
                      Vec<Level2>, Level1>);

// Memory that stays behind in the process.
template <typename T>
struct Has {
  int before;
  T it;
  int after[2];
};
template <typename T, Reason Why>
inline constexpr bool refuses_inside = refuses<T, Why, T>&& refuses<Has<T>, Why, T, Has<T>>&&
    refuses<Has<T[2]>, Why, T, T[2], Has<T[2]>>;
static_assert(refuses_inside<std::string, Reason::kPrivateMemory>);
static_assert(refuses_inside<std::vector<int>, Reason::kPrivateMemory>);
static_assert(refuses_inside<std::map<int, int>, Reason::kPrivateMemory>);
static_assert(refuses_inside<std::list<int>, Reason::kPrivateMemory>);
static_assert(refuses_inside<std::list<int, FakeAllocator<int>>, Reason::kNodeContainer>);
static_assert(refuses_inside<std::vector<bool>, Reason::kVectorBool>);
static_assert(refuses_inside<Vec<bool>, Reason::kVectorBool>);
static_assert(refuses_inside<std::shared_ptr<int>, Reason::kSmartPointer>);
static_assert(refuses_inside<std::weak_ptr<int>, Reason::kSmartPointer>);
static_assert(refuses_inside<std::unique_ptr<int>, Reason::kSmartPointer>);
static_assert(refuses_inside<std::unique_ptr<int[]>, Reason::kSmartPointer>);
static_assert(refuses_inside<std::string_view, Reason::kView>);
#if __cplusplus >= 202002L
static_assert(refuses_inside<std::span<int>, Reason::kView>);
static_assert(refuses<std::span<int, 4>, Reason::kView, std::span<int, 4>>);
#endif
static_assert(refuses_inside<std::function<void()>, Reason::kFunction>);
static_assert(refuses_inside<std::optional<int>, Reason::kNotAggregate>);
static_assert(refuses<Vec<std::string>, Reason::kPrivateMemory, std::string, Vec<std::string>>);

// Classes that cannot be searched.
struct Virtual {
  virtual void f() {}
  int n;
};
struct Abstract {
  virtual ~Abstract() = default;
  virtual void f() = 0;
};
struct Derived : Point {
  int n;
};
struct DerivedFromEmpty : Empty {
  int n;
  int& r;
};
struct NotCopied {
  NotCopied() = default;
  NotCopied(const NotCopied&) = delete;
  NotCopied& operator=(const NotCopied&) = delete;
};
struct DerivedFromNotCopied : NotCopied {
  int n;
};
struct DerivedTwice : Empty, NotCopied {};
class Private {
  [[maybe_unused]] int n = 0;
};
struct Constructed {
  Constructed() {}
  int n = 0;
};
union Either {
  int i;
  float f;
};
struct HasAnonymousUnion {
  int kind;
  union {
    Point p;
    float f;
  };
};
struct NeverDestroyed {
  ~NeverDestroyed() = delete;
  int n;
};
struct alignas(8192) OverAligned {
  int n;
};
struct WithTupleSize {
  int* hidden;
};
struct Wide {
  char c[64];
};

}  // namespace

template <>
struct std::tuple_size<WithTupleSize> : std::integral_constant<std::size_t, 0> {};

namespace {

static_assert(refuses_inside<Virtual, Reason::kVirtual>);
static_assert(refuses<Abstract, Reason::kVirtual, Abstract>);
static_assert(refuses_inside<Derived, Reason::kBaseClass>);
static_assert(refuses<DerivedFromEmpty, Reason::kBaseClass, DerivedFromEmpty>);
static_assert(!is_message_v<DerivedFromNotCopied>);
static_assert(!is_message_v<DerivedTwice>);
static_assert(refuses_inside<Private, Reason::kNotAggregate>);
static_assert(refuses_inside<Constructed, Reason::kNotAggregate>);
static_assert(refuses<Either, Reason::kUnion, Either>);
static_assert(refuses<Has<Either>, Reason::kUnion, Has<Either>>);
static_assert(refuses<HasAnonymousUnion, Reason::kUnion, HasAnonymousUnion>);
static_assert(refuses<NeverDestroyed, Reason::kNotDestructible, NeverDestroyed>);
static_assert(refuses_inside<OverAligned, Reason::kOverAligned> ||
              refuses<Has<OverAligned>, Reason::kOverAligned, Has<OverAligned>>);
static_assert(refuses<WithTupleSize, Reason::kNotAggregate, WithTupleSize>);
static_assert(refuses<std::atomic<Wide>, Reason::kLockedAtomic, std::atomic<Wide>>);

// Types that are no message at all.
static_assert(refuses<const int, Reason::kQualified, const int>);
static_assert(refuses<volatile Point, Reason::kQualified, volatile Point>);
static_assert(refuses<Point&, Reason::kQualified, Point&>);
static_assert(refuses<void, Reason::kNotObject, void>);
static_assert(refuses<void(), Reason::kNotObject, void()>);
static_assert(refuses<int[], Reason::kNotObject, int[]>);

template <typename T>
std::enable_if_t<is_message_v<T>, bool> can_send(const T&) {
  return true;
}
bool can_send(...) { return false; }

TEST_SUITE("compliance") {
  TEST_CASE("a frame with shared containers is a message") {
    CHECK(is_message_v<Frame>);
    CHECK(lot::assert_message<Frame>());
  }
  TEST_CASE("16 MiB of bytes count as one member") { CHECK(Fields<Big>::count == 2); }
  TEST_CASE("a struct of 40 members is searched and one of 41 is refused") {
    CHECK(is_message_v<Forty>);
    CHECK_FALSE(is_message_v<FortyOne>);
  }
  TEST_CASE("a raw pointer is found three levels down") { CHECK_FALSE(is_message_v<Level1>); }
  TEST_CASE("a struct that can only be made from its parts is searched all the same") {
    CHECK(is_message_v<NoDefault>);
    CHECK_FALSE(is_message_v<HasReference>);
  }
  TEST_CASE("is_message_v chooses an overload without an error") {
    CHECK(can_send(Point{}));
    CHECK_FALSE(can_send(Level3{}));
  }
}

}  // namespace
