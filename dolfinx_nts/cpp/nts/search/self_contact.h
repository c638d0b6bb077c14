#pragma once

#include "nts/search/local_search.h"

/// @brief Self contact: segments that a node of the same surface may touch.
namespace nts
{
/// @brief Lengths in the reference state, relative to the segment's size [-].
struct SelfContactRule
{
  /// Reference distance up to which a segment counts as a mesh neighbour of a
  /// node, or as the opposite face of its wall.
  static constexpr double near = 2;
  /// Depth behind a segment up to which a node counts as in front of it:
  /// round-off, such as of nodes on the other face of a closed crack.
  static constexpr double front = 1e-6;
};

/// @brief A surface that touches itself.
///
/// A node may touch a segment if
/// - it is above the segment, so that no nearer segment is between them,
/// - their normals are opposed,
/// - it is no deeper below the segment than the thickness of the cell there: a
///   deeper node is on the opposite face of a wall,
/// - in the reference state they are `near` apart, or the node is in front of
///   the segment with opposed normals, as in a notch, or on it, as in a closed
///   crack. That excludes neighbours on the mesh, whose normals are not
///   opposed, and the opposite face of the node's own wall, for any motion.
template <class S>
struct SelfContact
{
  std::span<const double> normal;    ///< at the nodes, outward, (n, 3)
  std::span<const double> X_node;    ///< reference, (n, 3) [m]
  std::span<const double> N_node;    ///< reference normals, (n, 3)
  SegmentSurface<S> reference;       ///< reference segments
  std::span<const double> thickness; ///< of the cells, (s,) [m]

  /// @brief Admissible segments of node i, see `find_segment`.
  struct OfNode : Anything
  {
    bool keeps(std::int32_t j, const Projection<S>& p) const noexcept
    {
      return S::outside(p.xi) <= LocalSearchRule::overhang
             && p.gap >= -own.thickness[j]
             && dot(vector(own.normal, i), p.normal) < 0
             && own.apart_in_reference(i, j);
    }

    bool touches(const Vec3&, std::int32_t j, const Projection<S>& p,
                 const Tree&) const noexcept
    {
      return keeps(j, p);
    }

    const SelfContact& own;
    std::size_t i;
  };

  OfNode of(std::size_t i) const noexcept { return {{}, *this, i}; }

  /// @brief Whether a node and a segment are not neighbours on the mesh, see
  /// the class.
  bool apart_in_reference(std::size_t i, std::int32_t j) const noexcept
  {
    const Pair<S> pair = {vector(X_node, i), reference.segment(j)};
    const double size = diameter<S>(pair.segment);
    const Vec3 centre = combine(S::phi(S::centre), pair.segment);
    if (norm(pair.node - centre) > (SelfContactRule::near + 1) * size)
      return true;
    const Projection<S> p = project(pair, reference.orientation[j]);
    if (!p.converged)
      return false;
    if (distance(pair, p) > SelfContactRule::near * size)
      return true;
    return p.gap > -SelfContactRule::front * size
           && dot(vector(N_node, i), p.normal) < 0;
  }
};
} // namespace nts
