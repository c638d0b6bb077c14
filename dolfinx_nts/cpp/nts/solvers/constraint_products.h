#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

/// @brief Products of constraint rows with eliminated directions: the small
/// systems of multipliers whose constraints involve each other's nodes.
namespace nts
{
/// @brief Entries of a sparse matrix; entries at the same place are summed.
struct Entries
{
  std::vector<std::int64_t> row, column;
  std::vector<double> value;
};

/// @brief Interpolation of displacements of nodes from vertices; with h = 0
/// each node is its own vertex.
struct Parents
{
  std::span<const std::int32_t> node; ///< (l, h) vertices of each node
  std::span<const double> weight;     ///< (l, h)
  std::size_t count;                  ///< h

  /// @brief Call visit(vertex, weight) for the vertices of a node.
  template <class Visit>
  void for_each(std::size_t i, Visit&& visit) const
  {
    if (count == 0)
      visit(i, 1.);
    for (std::size_t p = count * i; p < count * (i + 1); ++p)
      visit(static_cast<std::size_t>(node[p]), weight[p]);
  }
};

/// @brief Rows of m constrained nodes; constraint a of node i has number c i +
/// a.
struct ConstraintRows
{
  std::span<const std::int32_t> nodes; ///< (m, d), the constrained one first
  std::span<const std::int32_t> rank;  ///< (m,) constraints of each, up to c
  std::span<const double> value;       ///< (m, r, d b) with r >= c
  std::size_t length;                  ///< d
  std::size_t stored;                  ///< r

  /// @brief Row a of node i, b numbers per node.
  const double* row(std::size_t i, std::size_t a, std::size_t b) const noexcept
  {
    return value.data() + b * length * (stored * i + a);
  }
};

/// @brief Eliminated directions of constrained nodes: the normal of a node with
/// one constraint, otherwise the entries of the rows at the node itself.
/// @param[in] rows Rows.
/// @param[in] normal Unit normals, (m, b).
/// @param[in] c Most constraints of a node.
/// @param[in] b Components of a node.
/// @param[out] directions (m, c, b), 0 beyond the constraints of a node.
inline void eliminated_directions(const ConstraintRows& rows,
                                  std::span<const double> normal, std::size_t c,
                                  std::size_t b,
                                  std::span<double> directions) noexcept
{
  std::ranges::fill(directions, 0.);
  for (std::size_t i = 0; i < rows.rank.size(); ++i)
    for (std::int32_t a = 0; a < rows.rank[i]; ++a)
    {
      const double* row
          = rows.rank[i] == 1 ? normal.data() + b * i : rows.row(i, a, b);
      std::copy_n(row, b, directions.begin() + b * (c * i + a));
    }
}

/// @brief Multiply rows with directions.
/// @param[in] rows Rows G.
/// @param[in] parents Interpolation of dependent nodes from their vertices.
/// @param[in] directions Directions E of all nodes, (c, l, b); 0 without.
/// @param[in] c Most constraints of a node.
/// @param[in] b Components of a node.
/// @return Entries of G^T E that are not 0, row by row.
inline Entries products(const ConstraintRows& rows, const Parents& parents,
                        std::span<const double> directions, std::size_t c,
                        std::size_t b)
{
  Entries entries;
  const std::size_t d = rows.length, l = directions.size() / (c * b);
  for (std::size_t i = 0; i < rows.rank.size(); ++i)
    for (std::int32_t a = 0; a < rows.rank[i]; ++a)
      for (std::size_t k = 0; k < d; ++k)
      {
        const double* row = rows.row(i, a, b) + b * k;
        parents.for_each(rows.nodes[d * i + k],
                         [&](std::size_t vertex, double weight)
                         {
                           for (std::size_t e = 0; e < c; ++e)
                           {
                             const double* direction
                                 = directions.data() + b * (l * e + vertex);
                             // Entries without a column are skipped, also in
                             // rows that are NaN.
                             if (std::all_of(direction, direction + b,
                                             [](double value)
                                             { return value == 0; }))
                               continue;
                             double sum = 0;
                             for (std::size_t j = 0; j < b; ++j)
                               sum += weight * row[j] * direction[j];
                             if (sum == 0)
                               continue;
                             entries.row.push_back(c * rows.nodes[d * i] + a);
                             entries.column.push_back(c * vertex + e);
                             entries.value.push_back(sum);
                           }
                         });
      }
  return entries;
}
} // namespace nts
