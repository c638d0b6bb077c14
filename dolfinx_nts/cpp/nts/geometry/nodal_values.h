#pragma once

#include <cstddef>
#include <span>

namespace nts
{
/// @brief Values at the nodes that a rank owns, and then at ghosts.
template <class T>
struct NodalValues
{
  std::span<T> owned, ghosts;

  /// @brief Where value i is: with B of them a node, B i are those of node i.
  T* operator[](std::size_t i) const noexcept
  {
    return i < owned.size() ? owned.data() + i
                            : ghosts.data() + (i - owned.size());
  }
};

using KnownValues = NodalValues<const double>;
using ChangedValues = NodalValues<double>;
} // namespace nts
