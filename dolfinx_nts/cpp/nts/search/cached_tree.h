#pragma once

#include "nts/search/tree.h"

#include <optional>

/// @brief A tree over segments that is rebuilt only after they have moved.
namespace nts
{
/// @brief Tree over segments that move.
///
/// Its boxes exceed the segments by a margin. It is valid until a vertex has
/// moved farther than the margin.
class CachedTree
{
public:
  /// @param[in] vertices Rows of the positions, (s, k); must outlive the tree.
  /// @param[in] k Vertices of a segment.
  CachedTree(std::span<const std::int32_t> vertices, std::size_t k)
      : _vertices(vertices), _k(k), _rows(vertices.begin(), vertices.end())
  {
    std::ranges::sort(_rows);
    const auto [first, last] = std::ranges::unique(_rows);
    _rows.erase(first, last);
  }

  /// @brief Tree for these positions, (l, 3) [m], rebuilt if necessary.
  const Tree& at(std::span<const double> x)
  {
    if (!_tree || !holds(x))
      build(x);
    return *_tree;
  }

  /// @brief A tree with tight boxes around the segments at these positions.
  ///
  /// It is refitted at each call, in O(s). For many searches at any distance
  /// this saves time: with wide boxes, distant nodes would visit many segments.
  const Tree& tight_at(std::span<const double> x)
  {
    const Tree& wide = at(x);
    if (!_exact)
      _exact.emplace(wide);
    _exact->refit([&](std::int32_t i) { return bounds(x, segment(i)); });
    return *_exact;
  }

  /// @brief Points within a distance of the box of any segment.
  /// @param[in] points All points, (n, 3) [m].
  /// @param[in] begin, end Range of the points to be tested.
  /// @param[in] reach Largest distance [m].
  /// @param[in] x Positions, (l, 3) [m].
  /// @param[out] numbers Numbers of these points are appended, ascending.
  void near(std::span<const double> points, std::size_t begin, std::size_t end,
            double reach, std::span<const double> x,
            std::vector<std::int32_t>& numbers)
  {
    const Tree& tree = at(x);
    for (std::size_t n = begin; n < end; ++n)
    {
      const Vec3 point = vector(points, n);
      bool found = false;
      tree.nearest(point, reach,
                   [&](std::int32_t i)
                   {
                     const Box box = bounds(x, segment(i));
                     found = found
                             || box.squared_distance(point) <= reach * reach;
                     return found ? 0 : reach;
                   });
      if (found)
        numbers.push_back(static_cast<std::int32_t>(n));
    }
  }

  /// @brief Number of trees built so far.
  std::size_t num_built() const noexcept { return _num_built; }

private:
  /// Margin of the boxes relative to the mean extent of segments [-]. Larger:
  /// fewer rebuilds; smaller: fewer segments to be tested.
  static constexpr double _part = 0.2;

  std::span<const std::int32_t> segment(std::size_t i) const noexcept
  {
    return _vertices.subspan(_k * i, _k);
  }

  bool holds(std::span<const double> x) const noexcept
  {
    for (std::size_t i = 0; i < _rows.size(); ++i)
    {
      const Vec3 moved = vector(x, _rows[i]) - _x[i];
      for (const double component : moved)
        // False without an exception for NaN.
        if (!std::islessequal(std::abs(component), _margin))
          return false;
    }
    return true;
  }

  void build(std::span<const double> x)
  {
    std::vector<Box> boxes(_vertices.size() / _k);
    double extents = 0;
    for (std::size_t i = 0; i < boxes.size(); ++i)
    {
      boxes[i] = bounds(x, segment(i));
      const Vec3 extent = boxes[i].upper - boxes[i].lower;
      extents += std::ranges::max(extent);
    }
    _margin = boxes.empty() ? 0 : _part * extents / boxes.size();
    for (Box& box : boxes)
      box.widen(_margin);
    _x.clear();
    for (const std::int32_t row : _rows)
      _x.push_back(vector(x, row));
    _tree.emplace(std::move(boxes));
    _exact.reset();
    ++_num_built;
  }

  std::span<const std::int32_t> _vertices;
  std::size_t _k;
  std::vector<std::int32_t> _rows; // all vertices, each of them once
  std::vector<Vec3> _x;            // their positions when the tree was built
  double _margin = 0;
  std::optional<Tree> _tree, _exact;
  std::size_t _num_built = 0;
};
} // namespace nts
