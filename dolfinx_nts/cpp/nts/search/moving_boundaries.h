#pragma once

#include "nts/search/boundary.h"

/// @brief Boundaries of bodies at positions that change.
namespace nts
{
/// @brief Moving boundaries as views of arrays, with a tree over each, which is
/// built at the first positions and updated on demand.
class MovingBoundaries
{
public:
  using Rows = std::vector<std::span<const std::int32_t>>;

  /// @param[in] nodes Rows of the positions, (n) for each boundary.
  /// @param[in] triangles Rows of vertices in outward sense, (t, 3) for each.
  MovingBoundaries(Rows nodes, Rows triangles)
      : _nodes(std::move(nodes)), _triangles(std::move(triangles)),
        _moved(_nodes.size())
  {
  }

  /// @brief Number of boundaries.
  std::size_t size() const noexcept { return _nodes.size(); }

  /// @brief Set new positions, (l, 3) [m].
  void move(std::span<const double> x)
  {
    _x = x;
    _moved.assign(size(), !_boundaries.empty());
    if (_boundaries.empty())
      for (const std::span<const std::int32_t> triangles : _triangles)
        _boundaries.emplace_back(x, triangles);
  }

  /// @brief The boundary with this number, at the current positions.
  const Boundary& at(std::size_t number)
  {
    if (_moved[number])
      _boundaries[number].move(_x);
    _moved[number] = false;
    return _boundaries[number];
  }

  /// @brief Boxes around the nodes of each boundary [m].
  std::vector<Box> extents() const
  {
    std::vector<Box> boxes;
    for (const std::span<const std::int32_t> nodes : _nodes)
      boxes.push_back(bounds(_x, nodes));
    return boxes;
  }

  /// @brief Boxes around the displacements of the nodes of each boundary [m].
  /// @param[in] x, before Positions now and before, (l, 3) [m].
  std::vector<Box> displacements(std::span<const double> x,
                                 std::span<const double> before) const
  {
    std::vector<Box> boxes(size());
    for (std::size_t i = 0; i < size(); ++i)
      for (const std::int32_t node : _nodes[i])
        boxes[i].include(vector(x, node) - vector(before, node));
    return boxes;
  }

private:
  Rows _nodes, _triangles;
  std::vector<Boundary> _boundaries;
  std::vector<bool> _moved;
  std::span<const double> _x;
};
} // namespace nts
