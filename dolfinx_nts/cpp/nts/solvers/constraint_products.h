#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

/// @brief Products of the rows of constraints with the directions that nodes
/// give up: the small systems of multipliers that reach nodes of each other.
namespace nts
{
/// @brief Entries of a sparse matrix; several may have one place.
struct Entries
{
  std::vector<std::int64_t> row, column;
  std::vector<double> value;
};

/// @brief How the displacements of nodes follow from those of vertices.
struct Parents
{
  std::span<const std::int32_t> node; ///< (l, h) vertices of each node
  std::span<const double> weight;     ///< (l, h)
  std::size_t count;                  ///< h
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
};

/// @brief Multiply rows with directions.
/// @param[in] rows Rows G.
/// @param[in] parents How other nodes go with those that are constrained.
/// @param[in] directions Directions E of all nodes, (c, l, b); 0 without.
/// @param[in] c Most constraints of a node.
/// @param[in] b Components of a node.
/// @return Entries of G^T E that are not 0, row by row.
inline Entries products(const ConstraintRows& rows, const Parents& parents,
                        std::span<const double> directions, std::size_t c,
                        std::size_t b)
{
  Entries entries;
  const std::size_t h = parents.count, d = rows.length,
                    l = directions.size() / (c * b);
  for (std::size_t i = 0; i < rows.rank.size(); ++i)
    for (std::int32_t a = 0; a < rows.rank[i]; ++a)
      for (std::size_t k = 0; k < d; ++k)
      {
        const std::size_t node = rows.nodes[d * i + k];
        const double* row
            = rows.value.data() + b * (d * (rows.stored * i + a) + k);
        for (std::size_t p = h * node; p < h * (node + 1); ++p)
          for (std::size_t e = 0; e < c; ++e)
          {
            const std::size_t vertex = parents.node[p];
            const double* direction = directions.data() + b * (l * e + vertex);
            // Of a row that is NaN, too, only what has a column is an entry.
            if (std::all_of(direction, direction + b,
                            [](double value) { return value == 0; }))
              continue;
            double sum = 0;
            for (std::size_t j = 0; j < b; ++j)
              sum += parents.weight[p] * row[j] * direction[j];
            if (sum == 0)
              continue;
            entries.row.push_back(c * rows.nodes[d * i] + a);
            entries.column.push_back(c * vertex + e);
            entries.value.push_back(sum);
          }
      }
  return entries;
}

/// @brief Sort entries into rows, by counting.
/// @param[in] number Numbers of rows and columns, ascending, (n,).
/// @param[in] row, column, value Entries by these numbers, (e,).
/// @param[out] start Where each row begins, and the end, (n + 1,).
/// @param[out] place, sorted Columns, from 0, and values row by row, (e,).
/// @return Whether all numbers are known.
inline bool sort_rows(std::span<const std::int64_t> number,
                      std::span<const std::int64_t> row,
                      std::span<const std::int64_t> column,
                      std::span<const double> value,
                      std::span<std::int64_t> start,
                      std::span<std::int32_t> place, std::span<double> sorted)
{
  const auto find = [&](std::int64_t wanted) -> std::size_t
  {
    const auto there = std::ranges::lower_bound(number, wanted);
    return there != number.end() && *there == wanted ? there - number.begin()
                                                     : number.size();
  };
  std::vector<std::size_t> rows;
  std::ranges::fill(start, 0);
  for (const std::int64_t wanted : row)
  {
    rows.push_back(find(wanted));
    if (rows.back() == number.size())
      return false;
    ++start[rows.back() + 1];
  }
  for (std::size_t i = 0; i < number.size(); ++i)
    start[i + 1] += start[i];
  std::vector<std::int64_t> next(start.begin(), start.end());
  for (std::size_t e = 0; e < rows.size(); ++e)
  {
    const std::size_t there = find(column[e]);
    if (there == number.size())
      return false;
    place[next[rows[e]]] = static_cast<std::int32_t>(there);
    sorted[next[rows[e]]++] = value[e];
  }
  return true;
}
} // namespace nts
