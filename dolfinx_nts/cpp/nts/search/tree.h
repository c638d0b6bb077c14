#pragma once

#include "nts/geometry/box.h"

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <ranges>
#include <span>
#include <utility>
#include <vector>

/// @brief Bounding-volume tree over segments, for nearest-segment queries.
namespace nts
{
/// @brief Largest displacement of points [m], NaN if one is NaN.
/// @param[in] x, before Positions now and before, (n, 3) [m].
/// @param[in] rows Rows of these points.
inline double farthest(std::span<const double> x,
                       std::span<const double> before,
                       const std::ranges::input_range auto& rows) noexcept
{
  double square = 0;
  for (const std::size_t i : rows)
  {
    const Vec3 moved = vector(x, i) - vector(before, i);
    const double there = dot(moved, moved);
    if (std::isnan(there))
      return there;
    square = std::max(square, there);
  }
  return std::sqrt(square);
}

/// @brief Enters every branch of a tree.
struct Always
{
  bool operator()(std::int32_t) const noexcept { return true; }
};

/// @brief Balanced binary tree of the boxes of n segments, built in O(n log n).
class Tree
{
public:
  /// @brief Build the tree.
  /// @param[in] boxes One box for each segment, at least as large as it.
  explicit Tree(std::vector<Box> boxes)
      : _boxes(std::move(boxes)), _order(_boxes.size())
  {
    std::iota(_order.begin(), _order.end(), 0);
    if (!_order.empty())
      build(0, static_cast<std::int32_t>(_order.size()));
  }

  /// @brief Renumber the segments in the order in which the tree visits them.
  /// @return The former number of each.
  std::vector<std::int32_t> renumber()
  {
    std::vector<Box> boxes;
    for (const std::int32_t i : _order)
      boxes.push_back(_boxes[i]);
    _boxes = std::move(boxes);
    std::vector<std::int32_t> numbers(_order.size());
    std::iota(numbers.begin(), numbers.end(), 0);
    return std::exchange(_order, std::move(numbers));
  }

  /// @brief Refit the tree to new boxes of the same segments, in O(n).
  ///
  /// The tree remains efficient as long as segments keep their neighbours.
  /// @param[in] box_of Called with a segment; returns its box.
  template <class BoxOf>
  void refit(BoxOf&& box_of)
  {
    gather([&](std::int32_t i) { return _boxes[i] = box_of(i); },
           [&](std::int32_t b) -> Box& { return _branches[b].box; });
  }

  /// @brief Boxes around the segments of each branch.
  /// @param[in] box_of Called with a segment; returns a box.
  template <class BoxOf>
  std::vector<Box> around(BoxOf&& box_of) const
  {
    std::vector<Box> boxes(_branches.size());
    gather(box_of, [&](std::int32_t b) -> Box& { return boxes[b]; });
    return boxes;
  }

  /// @brief Whether a branch without children can be entered.
  /// @param[in] enters Whether to visit a branch, by its number.
  bool has_entry(const auto& enters, std::int32_t index = 0) const
  {
    if (_branches.empty() || !enters(index))
      return false;
    const Branch& branch = _branches[index];
    return branch.left < 0 || has_entry(enters, branch.left)
           || has_entry(enters, branch.right);
  }

  /// @brief Visit the segments whose box is nearer than the bound.
  /// @param[in] point The point [m].
  /// @param[in] bound Initial search radius [m].
  /// @param[in] visit Called with a segment; returns the new bound, NaN to end.
  /// @param[in] enters Whether to visit a branch, by its number.
  template <class Visit, class Enters = Always>
  void nearest(const Vec3& point, double bound, Visit&& visit,
               const Enters& enters = {}) const
  {
    if (!_branches.empty() && enters(0))
      descend(0, point, bound, visit, enters);
  }

  /// @brief Visit the segments whose box intersects a line between two points.
  template <class Visit>
  void along(const Vec3& begin, const Vec3& end, Visit&& visit) const
  {
    if (!_branches.empty())
      descend_along(0, begin, end, visit);
  }

private:
  /// Segments [begin, end) of the order, and children or, for a leaf, -1.
  struct Branch
  {
    std::int32_t begin, end;
    Box box = {};
    std::int32_t left = -1, right = -1;
  };

  /// @brief Compute the box of each branch from the boxes of its segments.
  /// @param[in] box_of Returns the box of a segment.
  /// @param[in] box_at Returns a reference to the box of a branch.
  template <class BoxOf, class BoxAt>
  void gather(BoxOf&& box_of, BoxAt&& box_at) const
  {
    // Children come after their branch.
    for (std::size_t b = _branches.size(); b-- > 0;)
    {
      const Branch& branch = _branches[b];
      Box box;
      if (branch.left < 0)
        for (std::int32_t i = branch.begin; i < branch.end; ++i)
          box.include(box_of(_order[i]));
      else
        for (const std::int32_t child : {branch.left, branch.right})
          box.include(box_at(child));
      box_at(b) = box;
    }
  }

  std::int32_t build(std::int32_t begin, std::int32_t end)
  {
    constexpr std::int32_t leaf = 4; // largest number of segments in a leaf
    Branch branch{.begin = begin, .end = end};
    for (std::int32_t i = begin; i < end; ++i)
      branch.box.include(_boxes[_order[i]]);
    const auto index = static_cast<std::int32_t>(_branches.size());
    _branches.push_back(branch);
    if (end - begin > leaf)
    {
      const Vec3 extent = branch.box.upper - branch.box.lower;
      const std::size_t axis
          = std::max_element(extent.begin(), extent.end()) - extent.begin();
      const std::int32_t middle = begin + (end - begin) / 2;
      std::nth_element(_order.begin() + begin, _order.begin() + middle,
                       _order.begin() + end,
                       [this, axis](std::int32_t a, std::int32_t b) noexcept
                       {
                         return _boxes[a].lower[axis] + _boxes[a].upper[axis]
                                < _boxes[b].lower[axis] + _boxes[b].upper[axis];
                       });
      const std::int32_t left = build(begin, middle);
      const std::int32_t right = build(middle, end);
      _branches[index].left = left;
      _branches[index].right = right;
    }
    return index;
  }

  template <class Visit>
  void descend_along(std::int32_t index, const Vec3& begin, const Vec3& end,
                     Visit& visit) const
  {
    const Branch& branch = _branches[index];
    if (!branch.box.meets(begin, end))
      return;
    if (branch.left >= 0)
    {
      descend_along(branch.left, begin, end, visit);
      descend_along(branch.right, begin, end, visit);
      return;
    }
    for (std::int32_t i = branch.begin; i < branch.end; ++i)
      if (_boxes[_order[i]].meets(begin, end))
        visit(_order[i]);
  }

  template <class Visit, class Enters>
  void descend(std::int32_t index, const Vec3& point, double& bound,
               Visit& visit, const Enters& enters) const
  {
    const Branch& branch = _branches[index];
    if (branch.left < 0)
    {
      for (std::int32_t i = branch.begin; i < branch.end; ++i)
        if (_boxes[_order[i]].squared_distance(point) <= bound * bound)
          bound = visit(_order[i]);
      return;
    }
    std::array<std::int32_t, 2> children = {branch.left, branch.right};
    Vec2 distances;
    for (std::size_t c = 0; c < 2; ++c)
      distances[c] = _branches[children[c]].box.squared_distance(point);
    const std::size_t first = distances[1] < distances[0] ? 1 : 0;
    for (const std::size_t c : {first, 1 - first})
      if (distances[c] <= bound * bound && enters(children[c]))
        descend(children[c], point, bound, visit, enters);
  }

  std::vector<Box> _boxes;
  std::vector<std::int32_t> _order;
  std::vector<Branch> _branches;
};
} // namespace nts
