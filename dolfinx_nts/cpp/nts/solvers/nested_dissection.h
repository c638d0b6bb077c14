#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

namespace nts
{
/// @brief Nested dissection of a symmetric graph by planes: nodes are bisected
/// recursively, and separators are eliminated after both halves (A. George,
/// SIAM J. Numer. Anal. 10 (1973)).
class NestedDissection
{
public:
  /// @brief Nodes that are eliminated together.
  struct Set
  {
    std::size_t begin, end; ///< their places in the order
    std::int32_t parent;    ///< next set that they are coupled to, or -1
  };

  /// @param[in] start Offsets of the neighbours of each node,
  /// (n + 1).
  /// @param[in] neighbour The neighbours, which may include the node itself.
  /// @param[in] X Positions, (n, 3).
  /// @param[in] smallest Number of nodes that are not divided further.
  NestedDissection(std::span<const std::int64_t> start,
                   std::span<const std::int32_t> neighbour,
                   std::span<const double> X, std::size_t smallest)
      : order(start.size() - 1), _start(start), _neighbour(neighbour), _X(X),
        _smallest(smallest), _side(order.size(), outside)
  {
    for (std::size_t i = 0; i < order.size(); ++i)
      order[i] = static_cast<std::int32_t>(i);
    std::vector<std::int32_t> roots;
    dissect(0, order.size(), roots);
  }

  std::vector<std::int32_t> order; ///< nodes in the order of elimination
  std::vector<Set> sets;           ///< each after its children

private:
  enum Side : std::int8_t
  {
    outside,
    below,
    above,
    between
  };

  /// @brief Order some nodes.
  /// @param[in,out] roots Sets without a parent, to which the sets of these
  /// nodes are appended.
  void dissect(std::size_t begin, std::size_t end,
               std::vector<std::int32_t>& roots)
  {
    const std::span nodes(order.data() + begin, end - begin);
    if (nodes.size() <= _smallest || !cut(nodes))
      return add(begin, end, {}, roots);
    std::ranges::stable_sort(nodes, {}, [&](auto i) { return _side[i]; });
    const auto first = [&](Side side)
    {
      return begin
             + static_cast<std::size_t>(
                 std::ranges::lower_bound(nodes, side, {},
                                          [&](auto i) { return _side[i]; })
                 - nodes.begin());
    };
    const std::size_t second = first(above), last = first(between);
    mark(nodes, outside);
    std::vector<std::int32_t> halves;
    dissect(begin, second, halves);
    dissect(second, last, halves);
    add(last, end, halves, roots);
  }

  /// @brief Add a set as the parent of other sets, if it has nodes.
  void add(std::size_t begin, std::size_t end,
           const std::vector<std::int32_t>& halves,
           std::vector<std::int32_t>& roots)
  {
    if (begin == end)
    {
      roots.insert(roots.end(), halves.begin(), halves.end());
      return;
    }
    const auto own = static_cast<std::int32_t>(sets.size());
    sets.push_back({begin, end, -1});
    for (const std::int32_t half : halves)
      sets[half].parent = own;
    roots.push_back(own);
  }

  /// @brief Mark nodes as below, above or separator; false if all have the same
  /// position.
  bool cut(std::span<const std::int32_t> nodes)
  {
    std::size_t fewest = std::numeric_limits<std::size_t>::max();
    std::vector<std::int8_t> best;
    std::vector<double> x(nodes.size());
    for (std::size_t axis = 0; axis < 3; ++axis)
    {
      for (std::size_t i = 0; i < nodes.size(); ++i)
        x[i] = coordinate(nodes[i], axis);
      const auto [least, most] = std::ranges::minmax(x);
      const auto middle = x.begin() + static_cast<std::ptrdiff_t>(x.size() / 2);
      std::ranges::nth_element(x, middle);
      // Nodes of one plane stay together.
      const double width = same * (most - least);
      double place = *middle - width;
      if (!(place > least))
        place = *middle + width;
      if (!(least < place && place < most))
        continue;
      for (const std::int32_t i : nodes)
        _side[i] = coordinate(i, axis) < place ? below : above;
      const std::size_t count = part(nodes);
      if (count >= fewest)
        continue;
      fewest = count;
      best.clear();
      for (const std::int32_t i : nodes)
        best.push_back(_side[i]);
    }
    for (std::size_t i = 0; i < best.size(); ++i)
      _side[nodes[i]] = best[i];
    return !best.empty();
  }

  /// @brief Mark nodes of one half that are adjacent to the other as separator;
  /// returns their number.
  std::size_t part(std::span<const std::int32_t> nodes)
  {
    std::array<std::vector<std::int32_t>, 2> rims;
    for (const std::int32_t i : nodes)
    {
      const auto own = static_cast<Side>(_side[i]);
      const Side other = own == below ? above : below;
      for (auto e = _start[i]; e < _start[i + 1]; ++e)
        if (_side[_neighbour[e]] == other)
        {
          rims[own - below].push_back(i);
          break;
        }
    }
    const auto& rim = rims[rims[1].size() < rims[0].size()];
    mark(rim, between);
    return rim.size();
  }

  void mark(std::span<const std::int32_t> nodes, Side side)
  {
    for (const std::int32_t i : nodes)
      _side[i] = side;
  }

  double coordinate(std::int32_t node, std::size_t axis) const noexcept
  {
    return _X[3 * static_cast<std::size_t>(node) + axis];
  }

  /// Relative extent below which nodes are in one plane [-].
  static constexpr double same = 1e-6;

  std::span<const std::int64_t> _start;
  std::span<const std::int32_t> _neighbour;
  std::span<const double> _X;
  std::size_t _smallest;
  std::vector<std::int8_t> _side;
};
} // namespace nts
