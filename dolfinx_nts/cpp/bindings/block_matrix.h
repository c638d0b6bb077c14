#pragma once

#include "array.h"
#include "nts/solvers/incomplete_factors.h"

namespace nts::bindings
{
/// @brief Components B of a node in a matrix of B x B blocks; 3 without blocks.
inline std::size_t components_of(const In<std::int32_t>& column,
                                 const Doubles& value,
                                 std::span<const double> behind = {})
{
  const std::size_t b = column.size();
  return b > 0 && value.size() + behind.size() == 4 * b ? 2 : 3;
}

/// @brief View of rows of B x B blocks, whose values may be divided between two
/// arrays; raise ValueError if the arrays do not agree.
template <std::size_t B>
BlockMatrix<B>
block_matrix(const In<std::int64_t>& start, const In<std::int32_t>& column,
             const Doubles& value, std::span<const double> behind = {})
{
  check("start", start, {any});
  check("column", column, {any});
  if (behind.size() % (B * B) != 0 || behind.size() > B * B * column.size())
    throw nb::value_error(
        "behind: expected whole blocks, at most one for each entry of column");
  check("value", value, {B * B * column.size() - behind.size()});
  const BlockMatrix<B> result = {.start = view(start),
                                 .column = view(column),
                                 .value = view(value),
                                 .behind = behind};
  if (result.start.empty())
    throw nb::value_error("start: expected at least one entry");
  if (result.start.front() != 0
      || static_cast<std::size_t>(result.start.back()) != column.size()
      || !std::ranges::is_sorted(result.start))
    throw nb::value_error(
        "start: expected ascending offsets, from 0 to the length of column");
  if (std::ranges::any_of(result.column, [](auto j) { return j < 0; }))
    throw nb::value_error("column: expected no negative entry");
  return result;
}
} // namespace nts::bindings
